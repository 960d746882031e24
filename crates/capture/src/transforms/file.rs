//! The JSON as it is written, and what its intrinsics mean (splatting.md §2.3).

use std::path::Path;

use serde::Deserialize;

use crate::{
    error::{Fault, Result, quoted},
    lens::Lens,
    optics::Optics,
    source::read_whole,
};

/// Largest list that is read \[bytes\]: a million frames.
const MAX_FILE: u64 = 512 << 20;

/// One `transforms*.json`. What a flavour adds beyond this (`aabb_scale`, `applied_transform`, …) describes how the poses came
/// about or how another program marches rays, and changes nothing here.
#[derive(Deserialize)]
pub(super) struct Transforms {
    #[serde(flatten)]
    pub optics: Stated,
    #[serde(default)]
    pub frames: Vec<Frame>,
    pub ply_file_path: Option<String>,
    pub train_filenames: Option<Vec<String>>,
    pub val_filenames: Option<Vec<String>>,
    pub test_filenames: Option<Vec<String>>,
}

#[derive(Deserialize)]
pub(super) struct Frame {
    pub file_path: Option<String>,
    pub mask_path: Option<String>,
    pub transform_matrix: Option<Vec<Vec<f64>>>,
    #[serde(flatten)]
    pub optics: Stated,
}

/// Intrinsics, of the file or of one frame.
#[derive(Clone, Deserialize)]
pub(super) struct Stated {
    camera_model: Option<String>,
    is_fisheye: Option<bool>,
    camera_angle_x: Option<f64>,
    camera_angle_y: Option<f64>,
    fl_x: Option<f64>,
    fl_y: Option<f64>,
    cx: Option<f64>,
    cy: Option<f64>,
    w: Option<f64>,
    h: Option<f64>,
    k1: Option<f64>,
    k2: Option<f64>,
    k3: Option<f64>,
    k4: Option<f64>,
    p1: Option<f64>,
    p2: Option<f64>,
}

impl Transforms {
    pub fn read(path: &Path) -> Result<Self> {
        Self::parse(path, &read_whole(path, MAX_FILE)?)
    }

    pub fn parse(path: &Path, json: &[u8]) -> Result<Self> {
        // Windows editors put a byte order mark before everything.
        let json = json.strip_prefix(b"\xef\xbb\xbf").unwrap_or(json);
        let file: Self = serde_json::from_slice(json).map_err(|e| {
            let place = format!("line {} column {}", e.line(), e.column());
            let text = e.to_string();
            let what = text.split(" at line ").next().unwrap_or(&text);
            let remedy = "correct the file (numbers such as NaN are not JSON) or export it again";
            Fault::new(format!("what JSON calls: {what}"), "frames with poses and intrinsics", remedy).at(path, place)
        })?;
        if file.frames.is_empty() {
            return Err(Fault::new("no frames", "a list 'frames' of posed images", "export the poses again").at(path, "frames"));
        }
        Ok(file)
    }
}

impl Stated {
    /// The file's values with those that a frame states in their place.
    pub fn overridden_by(&self, frame: &Self) -> Self {
        let pick = |of_frame: Option<f64>, of_file: Option<f64>| of_frame.or(of_file);
        // A frame's own focal length speaks for both axes, and so does its field of view: mixing them with the file's would
        // combine two cameras.
        let own_x = frame.fl_x.is_some() || frame.camera_angle_x.is_some();
        let of_file = |v: Option<f64>| if own_x { None } else { v };
        Self {
            camera_model: frame.camera_model.clone().or_else(|| self.camera_model.clone()),
            is_fisheye: frame.is_fisheye.or(self.is_fisheye),
            camera_angle_x: pick(frame.camera_angle_x, of_file(self.camera_angle_x)),
            camera_angle_y: pick(frame.camera_angle_y, of_file(self.camera_angle_y)),
            fl_x: pick(frame.fl_x, of_file(self.fl_x)),
            fl_y: pick(frame.fl_y, of_file(self.fl_y)),
            cx: pick(frame.cx, self.cx),
            cy: pick(frame.cy, self.cy),
            w: pick(frame.w, self.w),
            h: pick(frame.h, self.h),
            k1: pick(frame.k1, self.k1),
            k2: pick(frame.k2, self.k2),
            k3: pick(frame.k3, self.k3),
            k4: pick(frame.k4, self.k4),
            p1: pick(frame.p1, self.p1),
            p2: pick(frame.p2, self.p2),
        }
    }

    pub fn optics(&self) -> Result<Optics, Fault> {
        let k = [self.k1, self.k2, self.k3, self.k4].map(|v| v.unwrap_or(0.0));
        let p = [self.p1, self.p2].map(|v| v.unwrap_or(0.0));
        let model = self.camera_model.as_deref().unwrap_or("");
        let lens = match (model.to_ascii_uppercase().as_str(), self.is_fisheye) {
            ("OPENCV_FISHEYE", _) | ("" | "OPENCV", Some(true)) => Lens::Fisheye { k },
            // Without a name the coefficients speak for themselves (instant-ngp).
            ("" | "OPENCV" | "RADIAL" | "SIMPLE_RADIAL" | "PERSPECTIVE", _) => Lens::polynomial(k, p),
            ("PINHOLE" | "SIMPLE_PINHOLE", _) => Lens::Straight,
            _ => {
                let expected = "OPENCV, OPENCV_FISHEYE, PINHOLE, SIMPLE_PINHOLE, RADIAL or SIMPLE_RADIAL";
                let remedy = "undistort the images with the program that computed the poses and use those";
                return Err(Fault::new(format!("camera_model {}", quoted(model)), expected, remedy));
            }
        };
        let size = match (self.w, self.h) {
            (Some(w), Some(h)) => Some([w, h]),
            (None, None) => None,
            _ => return Err(Fault::new("only one of w and h", "both or none", "add the size of the photographs in pixels")),
        };
        Ok(Optics {
            focal: [self.fl_x, self.fl_y],
            angle: [self.camera_angle_x, self.camera_angle_y],
            centre: [self.cx, self.cy],
            size,
            lens,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn optics(json: &str) -> Result<Optics, Fault> {
        let file = Transforms::parse(Path::new("t.json"), json.as_bytes()).unwrap();
        file.optics.overridden_by(&file.frames[0].optics).optics()
    }

    #[test]
    fn flavours_of_intrinsics() {
        let ngp = optics(
            r#"{"camera_angle_x":0.7,"fl_x":500.0,"fl_y":501,"k1":0.1,"k2":0,"p1":0.01,"p2":0,"cx":9,"cy":8,"w":20.0,"h":10,"frames":[{}]}"#,
        );
        let ngp = ngp.unwrap();
        assert_eq!((ngp.focal, ngp.size), ([Some(500.0), Some(501.0)], Some([20.0, 10.0])));
        assert_eq!(ngp.lens, Lens::Polynomial { k: [0.1, 0.0, 0.0, 0.0], p: [0.01, 0.0] });
        let nerf = optics(r#"{"camera_angle_x":0.7,"frames":[{"rotation":0.01}]}"#).unwrap();
        assert_eq!((nerf.focal, nerf.angle[0], nerf.size, nerf.lens), ([None, None], Some(0.7), None, Lens::Straight));
        let fish = r#"{"fl_x":500,"k1":0.1,"k3":0.2,"camera_model":"OPENCV_FISHEYE","frames":[{}]}"#;
        assert_eq!(optics(fish).unwrap().lens, Lens::Fisheye { k: [0.1, 0.0, 0.2, 0.0] });
        assert!(optics(r#"{"fl_x":5,"is_fisheye":true,"frames":[{}]}"#).unwrap().lens == Lens::Fisheye { k: [0.0; 4] });
        assert!(optics(r#"{"fl_x":5,"k1":3,"camera_model":"PINHOLE","frames":[{}]}"#).unwrap().lens.is_straight());
        // A frame's own camera.
        let own = optics(r#"{"fl_x":500,"fl_y":400,"w":20,"h":10,"frames":[{"fl_x":300,"w":40,"h":30}]}"#).unwrap();
        assert_eq!((own.focal, own.size), ([Some(300.0), None], Some([40.0, 30.0])));
        assert!(optics(r#"{"fl_x":5,"camera_model":"EQUIRECTANGULAR","frames":[{}]}"#).unwrap_err().found.contains("EQUI"));
        assert!(optics(r#"{"fl_x":5,"w":5,"frames":[{}]}"#).is_err());
    }

    #[test]
    fn broken_json_is_placed() {
        for (json, what) in [
            ("", "line 1"),
            ("{\"frames\":[\n{\"transform_matrix\":[[NaN]]}]}", "line 2"),
            ("{\"frames\": 3}", "frames"),
            ("{\"frames\": []}", "no frames"),
            ("{}", "no frames"),
            ("[1, 2", "line 1"),
        ] {
            let message = Transforms::parse(Path::new("t.json"), json.as_bytes()).err().unwrap().to_string();
            assert!(message.contains(what) && message.starts_with("t.json: "), "{message}");
        }
        assert!(Transforms::parse(Path::new("t.json"), b"\xef\xbb\xbf{\"frames\":[{}]}").is_ok());
        assert!(Transforms::parse(Path::new("t.json"), "[".repeat(100_000).as_bytes()).is_err());
    }
}
