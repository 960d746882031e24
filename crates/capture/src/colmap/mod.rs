//! COLMAP sparse models: `sparse/0/`, `sparse/` or the folder itself, binary or text (splatting.md §2.1).

mod binary;
mod text;

use std::{
    collections::HashMap,
    path::{Path, PathBuf},
};

use crate::{
    Cloud,
    error::{Fault, Result, quoted},
    lens::Lens,
    listing::{Listed, Listing, Pose},
    optics::Optics,
    path::relative,
};

/// Above this many points the inaccurate ones are dropped (§2.5).
const ENOUGH_POINTS: usize = 50_000;
/// Reprojection error of a point that is dropped then \[px\].
const ACCURATE_PX: f64 = 2.0;

/// A camera as the file has it.
pub(crate) struct RawCamera {
    pub model: Model,
    pub size: [u64; 2],
    pub parameters: Vec<f64>,
}

/// An image as the file has it.
pub(crate) struct RawImage {
    pub place: String,
    pub name: String,
    pub quaternion: [f64; 4],
    pub translation: [f64; 3],
    pub camera: i64,
}

/// A 3-D point as the file has it.
pub(crate) struct RawPoint {
    pub position: [f64; 3],
    pub colour: [u8; 3],
    pub error: f64,
}

/// The camera models that are understood.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Model {
    SimplePinhole,
    Pinhole,
    SimpleRadial,
    Radial,
    Opencv,
    OpencvFisheye,
}

const MODELS: [(Model, &str, usize); 6] = [
    (Model::SimplePinhole, "SIMPLE_PINHOLE", 3),
    (Model::Pinhole, "PINHOLE", 4),
    (Model::SimpleRadial, "SIMPLE_RADIAL", 4),
    (Model::Radial, "RADIAL", 5),
    (Model::Opencv, "OPENCV", 8),
    (Model::OpencvFisheye, "OPENCV_FISHEYE", 8),
];

impl Model {
    fn by_id(id: i32) -> Result<Self, Fault> {
        usize::try_from(id).ok().and_then(|i| MODELS.get(i)).map(|m| m.0).ok_or_else(|| unknown(format!("camera model {id}")))
    }

    fn by_name(name: &str) -> Result<Self, Fault> {
        MODELS.iter().find(|m| m.1 == name).map(|m| m.0).ok_or_else(|| unknown(format!("camera model {}", quoted(name))))
    }

    fn parameters(self) -> usize {
        MODELS[self as usize].2
    }
}

fn unknown(found: String) -> Fault {
    let known: Vec<&str> = MODELS.iter().map(|m| m.1).collect();
    Fault::new(found, format!("one of {}", known.join(", ")), "run `colmap image_undistorter` and use the folder that it writes")
}

impl RawCamera {
    fn optics(&self) -> Result<Optics, Fault> {
        let size = self.size.map(|v| Some(v as f64));
        let p = &self.parameters;
        if p.len() != self.model.parameters() {
            let expected = format!("{} for {}", self.model.parameters(), MODELS[self.model as usize].1);
            return Err(Fault::new(format!("{} camera parameters", p.len()), expected, "export the model again"));
        }
        let (focal, centre, rest) = match self.model {
            Model::SimplePinhole | Model::SimpleRadial | Model::Radial => ([p[0], p[0]], [p[1], p[2]], &p[3..]),
            Model::Pinhole | Model::Opencv | Model::OpencvFisheye => ([p[0], p[1]], [p[2], p[3]], &p[4..]),
        };
        let k = |i: usize| rest.get(i).copied().unwrap_or(0.0);
        let lens = match self.model {
            Model::SimplePinhole | Model::Pinhole => Lens::Straight,
            Model::SimpleRadial => Lens::polynomial([k(0), 0.0, 0.0, 0.0], [0.0; 2]),
            Model::Radial => Lens::polynomial([k(0), k(1), 0.0, 0.0], [0.0; 2]),
            Model::Opencv => Lens::polynomial([k(0), k(1), 0.0, 0.0], [k(2), k(3)]),
            Model::OpencvFisheye => Lens::Fisheye { k: [k(0), k(1), k(2), k(3)] },
        };
        Ok(Optics {
            focal: focal.map(Some),
            angle: [None; 2],
            centre: centre.map(Some),
            size: size[0].zip(size[1]).map(|(w, h)| [w, h]),
            lens,
        })
    }
}

/// The folder and the encoding of the model in a capture's folder.
pub(crate) fn find(folder: &Path) -> Option<(PathBuf, bool)> {
    [folder.join("sparse/0"), folder.join("sparse"), folder.to_path_buf()].into_iter().find_map(|model| {
        let has = |e: &str| ["cameras", "images"].iter().all(|f| model.join(format!("{f}.{e}")).is_file());
        [("bin", true), ("txt", false)].into_iter().find(|(e, _)| has(e)).map(|(_, binary)| (model.clone(), binary))
    })
}

/// Reads the model; the images are looked for in `images/` beside it.
pub(crate) fn read(folder: &Path, model: &Path, binary: bool) -> Result<Listing> {
    let file = |stem: &str| model.join(format!("{stem}.{}", if binary { "bin" } else { "txt" }));
    let (cameras_file, images_file, points_file) = (file("cameras"), file("images"), file("points3D"));
    let (cameras, images) = if binary {
        (binary::cameras(&cameras_file)?, binary::images(&images_file)?)
    } else {
        (text::cameras(&cameras_file)?, text::images(&images_file)?)
    };
    let mut notes = Vec::new();
    let points = if points_file.is_file() {
        let all = if binary { binary::points(&points_file)? } else { text::points(&points_file)? };
        cloud(all, &mut notes)
    } else {
        notes.push(format!("{}: no such file, so there are no starting points from the photographs", points_file.display()));
        None
    };

    let mut optics: HashMap<i64, Optics> = HashMap::new();
    for (id, camera) in &cameras {
        let place = format!("camera {id}");
        if optics.insert(*id, camera.optics().map_err(|f| f.at(&cameras_file, &*place))?).is_some() {
            let fault = Fault::new(format!("camera {id} a second time"), "every camera once", "export the model again");
            return Err(fault.at(&cameras_file, place));
        }
    }
    let names: Result<Vec<String>> = images.iter().map(|i| relative(&i.name).map_err(|f| f.at(&images_file, &*i.place))).collect();
    let names = names?;
    let (base, root) = image_root(folder, model, names.first());
    let views = images.iter().zip(names).map(|(image, name)| {
        let fail = |f: Fault| f.at(&images_file, &*image.place);
        let optics = *optics.get(&image.camera).ok_or_else(|| {
            let expected = format!("a camera of {}", cameras_file.display());
            fail(Fault::new(format!("camera {}", image.camera), expected, "export the model again: its files do not belong together"))
        })?;
        let pose = Pose::from_quaternion(image.quaternion, image.translation).map_err(fail)?;
        let place = image.place.clone();
        Ok(Listed { image: root.join(&name), name, mask: None, optics, pose, test: None, file: images_file.clone(), place })
    });
    let views = views.collect::<Result<Vec<_>>>()?;
    let kind = if binary { "colmap (binary)" } else { "colmap (text)" };
    Ok(Listing { kind, file: images_file, base, views, points, notes })
}

/// Where the images are: `images/` in the capture's folder, or beside `sparse/` if the model's own folder was given, or
/// directly in the folder. Returns the folder above and the folder of the images.
fn image_root(folder: &Path, model: &Path, first: Option<&String>) -> (PathBuf, PathBuf) {
    // Steps up are taken in the path as it is, so that a relative folder has no parent to climb to by mistake.
    let above: Vec<&Path> = if model == folder { folder.ancestors().take(3).collect() } else { vec![folder] };
    let has_images = |base: &&&Path| {
        let name = base.join("images");
        name.is_dir() || [2, 4, 8].iter().any(|r| base.join(format!("images_{r}")).is_dir())
    };
    if let Some(base) = above.iter().find(has_images) {
        return (base.to_path_buf(), base.join("images"));
    }
    match first {
        Some(name) if folder.join(name).is_file() => (folder.to_path_buf(), folder.to_path_buf()),
        _ => (folder.to_path_buf(), folder.join("images")),
    }
}

fn cloud(mut points: Vec<RawPoint>, notes: &mut Vec<String>) -> Option<Cloud> {
    let all = points.len();
    let usable = |p: &RawPoint| p.position.iter().all(|v| v.is_finite() && v.abs() < f64::from(f32::MAX));
    points.retain(usable);
    if points.len() < all {
        notes.push(format!("{} of {all} reconstructed points are not finite and were left out", all - points.len()));
    }
    // An unknown error (negative or not a number) is no reason to drop a point.
    let accurate = |p: &RawPoint| p.error.is_nan() || p.error <= ACCURATE_PX;
    if points.iter().filter(|p| accurate(p)).count() > ENOUGH_POINTS {
        points.retain(accurate);
    }
    if points.is_empty() {
        notes.push("the reconstruction holds no points".into());
        return None;
    }
    Some(Cloud {
        position: points.iter().map(|p| p.position.map(|v| v as f32)).collect(),
        colour: points.iter().map(|p| p.colour).collect(),
    })
}
