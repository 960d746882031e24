//! `transforms.json` of NeRF-synthetic, Blender, nerfstudio and instant-ngp (splatting.md §2.3).

mod file;

use std::{
    collections::HashMap,
    path::{Path, PathBuf},
};

use crate::{
    Cloud,
    error::{Fault, Result, quoted},
    listing::{EXTENSIONS, Listed, Listing, Pose},
    path::relative,
};
use file::{Frame, Transforms};

/// Which files a folder has.
pub(crate) enum Found {
    /// `transforms.json`.
    One,
    /// `transforms_train.json` with or without its siblings.
    Split,
}

/// Whether the folder holds poses of this kind; separate files of the split win, as they say more.
pub(crate) fn find(folder: &Path) -> Option<Found> {
    if folder.join("transforms_train.json").is_file() {
        return Some(Found::Split);
    }
    folder.join("transforms.json").is_file().then_some(Found::One)
}

pub(crate) fn read(folder: &Path, found: &Found) -> Result<Listing> {
    match found {
        Found::One => one(folder),
        Found::Split => split(folder),
    }
}

fn one(folder: &Path) -> Result<Listing> {
    let path = folder.join("transforms.json");
    let file = Transforms::read(&path)?;
    let mut views = views(folder, &path, &file, None)?;
    let mut notes = Vec::new();
    if let Some(train) = &file.train_filenames {
        let test = file.test_filenames.as_ref().filter(|t| !t.is_empty()).or(file.val_filenames.as_ref());
        let mut side = HashMap::new();
        for (names, is_test) in [(Some(train), false), (test, true)] {
            for name in names.into_iter().flatten() {
                side.insert(relative(name).map_err(|f| f.at(&path, "train_filenames and test_filenames"))?, is_test);
            }
        }
        let all = views.len();
        views.retain_mut(|(written, v)| {
            v.test = side.get(written).or_else(|| side.get(&v.name)).copied();
            v.test.is_some()
        });
        if views.len() < all {
            notes.push(format!(
                "{} of {all} frames stand in neither train_filenames nor test_filenames and were left out",
                all - views.len()
            ));
        }
        if views.is_empty() {
            let fault = Fault::new("names that match no frame", "file_path values of the frames", "correct the lists or remove them");
            return Err(fault.at(&path, "train_filenames"));
        }
    }
    let points = cloud(folder, &path, &file)?;
    let views = views.into_iter().map(|v| v.1).collect();
    Ok(Listing { kind: "transforms.json", file: path, base: folder.to_path_buf(), views, points, notes })
}

fn split(folder: &Path) -> Result<Listing> {
    let path = folder.join("transforms_train.json");
    let train = Transforms::read(&path)?;
    let mut all = views(folder, &path, &train, Some(false))?;
    let points = cloud(folder, &path, &train)?;
    let mut notes = Vec::new();
    let siblings = ["test", "val"].map(|s| folder.join(format!("transforms_{s}.json")));
    let mut present = siblings.iter().filter(|p| p.is_file());
    match present.next() {
        Some(test) => all.extend(views(folder, test, &Transforms::read(test)?, Some(true))?),
        None => notes.push("there is neither transforms_test.json nor transforms_val.json: no views to test with".into()),
    }
    if let Some(unused) = present.next() {
        notes.push(format!("{} was not used: the test views are those of transforms_test.json", unused.display()));
    }
    let views = all.into_iter().map(|v| v.1).collect();
    Ok(Listing { kind: "transforms_train.json", file: path, base: folder.to_path_buf(), views, points, notes })
}

/// The frames of a file, each with its path as it was written.
fn views(folder: &Path, path: &Path, file: &Transforms, test: Option<bool>) -> Result<Vec<(String, Listed)>> {
    let mut views = Vec::with_capacity(file.frames.len());
    for (i, frame) in file.frames.iter().enumerate() {
        let mut place = format!("frame {i}");
        let fail = |place: &str, f: Fault| f.at(path, place);
        let Some(written) = &frame.file_path else {
            return Err(fail(&place, Fault::new("no file_path", "the path of the image", "add it or remove the frame")));
        };
        place = format!("frame {i} {}", quoted(written));
        let Some(matrix) = &frame.transform_matrix else {
            let remedy = "add the camera's pose or remove the frame";
            return Err(fail(&place, Fault::new("no transform_matrix", "four rows of four numbers", remedy)));
        };
        let written = relative(written).map_err(|f| fail(&place, f))?;
        let pose = Pose::from_opengl(matrix).map_err(|f| fail(&place, f))?;
        let optics = file.optics.overridden_by(&frame.optics).optics().map_err(|f| fail(&place, f))?;
        let (name, image) = image_of(folder, &written);
        let mask = mask_of(folder, frame).map_err(|f| fail(&place, f))?;
        views.push((written, Listed { name, image, mask, optics, pose, test, file: path.to_path_buf(), place }));
    }
    Ok(views)
}

/// A path without an extension gets the one of the file that is there, `.png` before all (NeRF-synthetic).
fn image_of(folder: &Path, written: &str) -> (String, PathBuf) {
    let known = |e: &str| EXTENSIONS.iter().any(|x| x.eq_ignore_ascii_case(e));
    let as_is = folder.join(written);
    if as_is.is_file() || as_is.extension().and_then(|e| e.to_str()).is_some_and(known) {
        return (written.to_owned(), as_is);
    }
    let found = EXTENSIONS.iter().map(|e| format!("{written}.{e}")).find(|name| folder.join(name).is_file());
    let name = found.unwrap_or_else(|| format!("{written}.png"));
    let image = folder.join(&name);
    (name, image)
}

fn mask_of(folder: &Path, frame: &Frame) -> Result<Option<PathBuf>, Fault> {
    let Some(written) = &frame.mask_path else { return Ok(None) };
    let mask = folder.join(relative(written)?);
    if !mask.is_file() {
        let expected = "an image, white where pixels count";
        return Err(Fault::new(format!("mask_path {} without a file", quoted(written)), expected, "add the mask or remove mask_path"));
    }
    Ok(Some(mask))
}

/// The points that `ply_file_path` names; they are in the frame of the poses.
fn cloud(folder: &Path, path: &Path, file: &Transforms) -> Result<Option<Cloud>> {
    let Some(written) = &file.ply_file_path else { return Ok(None) };
    let ply = folder.join(relative(written).map_err(|f| f.at(path, "ply_file_path"))?);
    if !ply.is_file() {
        let remedy = "add the file or remove ply_file_path (training then starts from random points)";
        return Err(Fault::new(format!("{} without a file", quoted(written)), "a PLY file of points", remedy).at(path, "ply_file_path"));
    }
    let mesh = megas_formats::read_mesh_ply(&ply)?;
    let grey = mesh.colours.len() != mesh.positions.len();
    let colour = |i: usize| if grey { [128; 3] } else { mesh.colours[i].map(|v| (v.clamp(0.0, 1.0) * 255.0 + 0.5) as u8) };
    Ok(Some(Cloud { colour: (0..mesh.positions.len()).map(colour).collect(), position: mesh.positions }))
}
