//! What the readers hand over: which photograph, through which lens, from where. Nothing is decoded yet.

use std::path::{Path, PathBuf};

use megas_math::{Mat3, Vec3, mat3, quat, svd, vec3};

use crate::{Cloud, error::Fault, optics::Optics};

/// Everything that a capture's lists say.
pub(crate) struct Listing {
    pub kind: &'static str,
    /// The list that views are taken from, for messages.
    pub file: PathBuf,
    /// The folder that `images/`, `images_2/` and `masks/` stand in.
    pub base: PathBuf,
    pub views: Vec<Listed>,
    pub points: Option<Cloud>,
    pub notes: Vec<String>,
}

/// One listed photograph.
pub(crate) struct Listed {
    /// Identity: the relative path of the image.
    pub name: String,
    /// The image file, which may be missing.
    pub image: PathBuf,
    /// A mask that the list itself names.
    pub mask: Option<PathBuf>,
    pub optics: Optics,
    pub pose: Pose,
    /// Said by the list; otherwise the order of the names decides.
    pub test: Option<bool>,
    /// The file that lists it, and where in it.
    pub file: PathBuf,
    pub place: String,
}

/// World→camera: `p = W x + t`, x right, y down, z forward.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Pose {
    pub rotation: Mat3<f64>,
    pub translation: Vec3<f64>,
}

/// Largest departure of `RᵀR` from the identity that rounding in a text file explains.
const ROTATION_TOLERANCE: f64 = 1e-2;

impl Pose {
    /// COLMAP: scalar-first quaternion and translation, world→camera already.
    pub fn from_quaternion(q: [f64; 4], t: [f64; 3]) -> Result<Self, Fault> {
        let remedy = "run the pose estimation again or remove this image from the list";
        if q.iter().chain(&t).any(|v| !v.is_finite() || v.abs() > f64::from(f32::MAX)) {
            return Err(Fault::new(format!("the pose {q:?} {t:?}"), "finite numbers", remedy));
        }
        let norm = q.iter().map(|v| v * v).sum::<f64>().sqrt();
        if (norm - 1.0).abs() > ROTATION_TOLERANCE {
            return Err(Fault::new(format!("a quaternion of length {norm}"), "length 1", remedy));
        }
        Ok(Self { rotation: quat::to_mat3(q), translation: t })
    }

    /// `transforms.json`: camera→world with OpenGL axes (x right, y up, z backward); three or four rows of four.
    pub fn from_opengl(m: &[Vec<f64>]) -> Result<Self, Fault> {
        let remedy = "export the poses again or remove this frame from the list";
        if !(m.len() == 3 || m.len() == 4) || m.iter().any(|row| row.len() != 4) {
            return Err(Fault::new(format!("a transform_matrix of {} rows", m.len()), "four rows of four numbers", remedy));
        }
        if m.iter().flatten().any(|v| !v.is_finite() || v.abs() > f64::from(f32::MAX)) {
            return Err(Fault::new("a number that is not finite in transform_matrix", "finite numbers", remedy));
        }
        if m.get(3).is_some_and(|row| row[..] != [0.0, 0.0, 0.0, 1.0]) {
            return Err(Fault::new(format!("the last row {:?} in transform_matrix", m[3]), "[0, 0, 0, 1]", remedy));
        }
        let a: Mat3<f64> = [0, 1, 2].map(|r| [m[r][0], m[r][1], m[r][2]]);
        let gram = mat3::mul(mat3::transpose(a), a);
        let error = mat3::norm(mat3::sub(gram, mat3::identity()));
        let det = mat3::det(a);
        // Columns of equal length at right angles: a rotation that was scaled.
        let scale = (mat3::trace(gram) / 3.0).sqrt();
        if error > ROTATION_TOLERANCE || det < 0.0 {
            let scaled = mat3::norm(mat3::sub(mat3::scale(gram, 1.0 / (scale * scale)), mat3::identity())) < ROTATION_TOLERANCE;
            let found = match (det < 0.0, scaled) {
                (true, _) => format!("a mirrored camera (determinant {det:.4}) in transform_matrix"),
                (_, true) => format!("a rotation scaled by {scale:.4} in transform_matrix"),
                _ => "rows that are no rotation in transform_matrix".to_owned(),
            };
            return Err(Fault::new(found, "a rotation (orthonormal, determinant 1)", remedy));
        }
        // What rounding left over would shear every projection a little; the nearest rotation does not.
        let a = svd::polar_rotation(a);
        let (x, y, z) = (mat3::column(a, 0), mat3::column(a, 1), mat3::column(a, 2));
        let rotation = [x, vec3::scale(y, -1.0), vec3::scale(z, -1.0)];
        let centre = [m[0][3], m[1][3], m[2][3]];
        Ok(Self { rotation, translation: vec3::scale(mat3::mul_vec(rotation, centre), -1.0) })
    }
}

impl Listed {
    pub fn fault(&self, fault: Fault) -> crate::CaptureError {
        fault.at(&self.file, &*self.place)
    }

    /// Where the image stands if somebody reduced it already: `base/images/x` becomes `base/images_r/x` (also with another
    /// extension, as some benchmarks store it).
    pub fn reduced(&self, base: &Path, factor: u32) -> Option<PathBuf> {
        let inside = self.image.strip_prefix(base.join("images")).ok()?;
        existing(&base.join(format!("images_{factor}")).join(inside))
    }

    /// The mask beside the images: `masks/<name>.png` or the same with the extension replaced.
    pub fn mask_beside(&self, base: &Path) -> Option<PathBuf> {
        let folder = base.join("masks");
        let short = self.name.strip_prefix("images/").unwrap_or(&self.name);
        [short, &self.name].into_iter().find_map(|name| {
            let whole = folder.join(format!("{name}.png"));
            [whole, folder.join(name).with_extension("png")].into_iter().find(|p| p.is_file())
        })
    }
}

/// Extensions of photographs, in the order they are tried.
pub(crate) const EXTENSIONS: [&str; 6] = ["png", "jpg", "jpeg", "PNG", "JPG", "JPEG"];

/// The file itself or the same name with another extension, if there is one.
pub(crate) fn existing(path: &Path) -> Option<PathBuf> {
    if path.is_file() {
        return Some(path.to_path_buf());
    }
    EXTENSIONS.iter().map(|e| path.with_extension(e)).find(|p| p.is_file())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The OpenGL camera at (0, 0, 5) with no rotation looks along −z with y up; ours sees +y of the world as up, that is −v.
    #[test]
    fn opengl_axes_become_opencv_axes() {
        let m = [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 5.0], [0.0, 0.0, 0.0, 1.0]].map(Vec::from);
        let pose = Pose::from_opengl(&m).unwrap();
        let see = |x: Vec3<f64>| vec3::add(mat3::mul_vec(pose.rotation, x), pose.translation);
        assert_eq!(see([0.0, 0.0, 0.0]), [0.0, 0.0, 5.0]);
        assert_eq!(see([1.0, 2.0, 0.0]), [1.0, -2.0, 5.0]);
        assert_eq!(Pose::from_opengl(&m[..3]).unwrap(), pose);
    }

    #[test]
    fn poses_that_are_none_are_refused() {
        let good = [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 5.0], [0.0, 0.0, 0.0, 1.0]].map(Vec::from);
        let with = |r: usize, c: usize, v: f64| {
            let mut m = good.clone();
            m[r][c] = v;
            Pose::from_opengl(&m).unwrap_err().found
        };
        assert!(with(0, 0, -1.0).contains("mirrored"));
        assert!(with(0, 1, 0.5).contains("no rotation"));
        assert!(with(0, 3, f64::NAN).contains("not finite"));
        assert!(with(3, 0, 1.0).contains("last row"));
        assert!(with(0, 0, 0.0).contains("no rotation"));
        let doubled: Vec<Vec<f64>> =
            good.iter().enumerate().map(|(r, v)| v.iter().map(|x| if r < 3 { 2.0 * x } else { *x }).collect()).collect();
        assert!(Pose::from_opengl(&doubled).unwrap_err().found.contains("scaled by 2.0"));
        assert!(Pose::from_opengl(&good[..2]).is_err());
        assert!(Pose::from_quaternion([0.0; 4], [0.0; 3]).is_err());
        assert!(Pose::from_quaternion([1.0, 0.0, 0.0, 0.0], [f64::NAN, 0.0, 0.0]).is_err());
    }
}
