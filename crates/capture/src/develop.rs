//! From lists to views: decoding, straightening, masking, reducing and splitting, in parallel within the memory budget.

use std::path::Path;

use megas_math::{mat3, vec3};
use megas_model::{Camera, Projection};
use rayon::prelude::*;

use crate::{
    Capture, CaptureError, Cloud, Options, Photo,
    error::{Fault, Result, quoted},
    listing::{Listed, Listing},
    optics::{Intrinsics, Size},
    picture::{decode, decode_mask},
    plan::{Job, plan},
    resample::{Filter, resize},
    undistort::{Rect, Straightener},
};

/// Loads what the listing names.
pub(crate) fn develop(folder: &Path, mut listing: Listing, options: &Options, stopped: &(dyn Fn() -> bool + Sync)) -> Result<Capture> {
    if listing.views.is_empty() {
        let remedy = "the pose estimation registered no image: run it again, with more overlap between the photographs";
        return Err(Fault::new("no images", "at least one posed image", remedy).at(&listing.file, "the list"));
    }
    listing.views.sort_by(|a, b| a.name.cmp(&b.name));
    if let Some(pair) = listing.views.windows(2).find(|p| p[0].name == p[1].name) {
        let fault = Fault::new(format!("{} a second time", quoted(&pair[1].name)), "every image once", "remove one of the two entries");
        return Err(pair[1].fault(fault));
    }
    let mut notes = std::mem::take(&mut listing.notes);
    let plan = plan(folder, &listing, options, &mut notes)?;
    if plan.reduced {
        notes.push("images that were reduced already were taken from the folder beside images/".into());
    }
    let work: Vec<(&Listed, &Job)> = listing.views.iter().zip(&plan.jobs).collect();
    let mut photos = Vec::with_capacity(work.len());
    for batch in work.chunks(plan.at_once.max(1)) {
        let one =
            |(view, job): &(&Listed, &Job)| if stopped() { Err(CaptureError::Stopped) } else { photo(view, job, options.crop_undistorted) };
        let done: Vec<Result<Photo>> = batch.par_iter().map(one).collect();
        for p in done {
            photos.push(p?);
        }
    }
    drop_opaque_alpha(&mut photos, &mut notes);
    if let Some(cloud) = &listing.points {
        check_cloud(cloud, &photos, &mut notes);
    }
    let test = test_flags(&listing, options, &mut notes);
    let (mut train, mut tested) = (Vec::new(), Vec::new());
    for (photo, is_test) in photos.into_iter().zip(test) {
        if is_test { &mut tested } else { &mut train }.push(photo);
    }
    if train.len() > 1 && spread(&train) == 0.0 {
        notes.push("all cameras stand at the same place: depth cannot be told from these views".into());
    }
    Ok(Capture { train, test: tested, points: listing.points, kind: listing.kind, notes })
}

/// Develops one photograph.
fn photo(view: &Listed, job: &Job, crop: bool) -> Result<Photo> {
    let picture = decode(&job.image, &job.header)?;
    let (mut size, channels) = (picture.size, picture.channels);
    let mut pixels = picture.pixels;
    let mut intrinsics = job.intrinsics;
    let mut mask = match &job.mask {
        Some((path, header)) => Some(resize(&decode_mask(path, header)?, 1, header.size, size, Filter::Area)),
        None => None,
    };
    let mut target = job.target;
    if !intrinsics.lens.is_straight() {
        let straightener = Straightener::new(&intrinsics);
        let whole = Rect { first: [0, 0], size };
        let area = if crop { straightener.full_area().ok_or_else(|| view.fault(nothing_left()))? } else { whole };
        let (straight, valid) = straightener.straighten(&pixels, channels, area);
        let seen = valid.iter().filter(|v| **v == 255).count();
        if seen == 0 {
            return Err(view.fault(nothing_left()));
        }
        mask = match mask {
            Some(user) => {
                let (mut user, _) = straightener.straighten(&user, 1, area);
                user.iter_mut().zip(&valid).for_each(|(m, v)| *m = (*m).min(*v));
                Some(user)
            }
            None => (seen < valid.len()).then_some(valid),
        };
        pixels = straight;
        if area != whole {
            // The same reduction as of the whole image; the exact ratio of what results goes into the intrinsics.
            target = [0, 1].map(|a| {
                let reduced = f64::from(area.size[a]) * f64::from(target[a]) / f64::from(size[a]);
                (reduced.round() as u32).max(1)
            });
            size = area.size;
            intrinsics.centre = [0, 1].map(|a| intrinsics.centre[a] - f64::from(area.first[a]));
            intrinsics.size = size;
        }
    }
    if size != target {
        pixels = resize(&pixels, channels, size, target, job.filter);
        mask = mask.map(|m| resize(&m, 1, size, target, job.filter));
    }
    let mask = mask.filter(|m| m.iter().any(|v| *v < 255));
    let camera = camera(view, &intrinsics.resized(target), target);
    Ok(Photo { name: view.name.clone(), camera, channels: channels as u32, pixels, mask })
}

fn nothing_left() -> Fault {
    let remedy = "run the camera calibration again, or use images that are undistorted already";
    Fault::new("distortion that leaves no pixel of the image", "coefficients that suit the lens", remedy)
}

fn camera(view: &Listed, intrinsics: &Intrinsics, size: Size) -> Camera {
    let [fx, fy] = intrinsics.focal.map(|v| v as f32);
    let [cx, cy] = intrinsics.centre.map(|v| v as f32);
    Camera {
        rotation: mat3::cast(view.pose.rotation),
        translation: vec3::cast(view.pose.translation),
        projection: Projection::Pinhole { fx, fy },
        cx,
        cy,
        width: size[0],
        height: size[1],
    }
}

/// Alpha channels that hide nothing anywhere are no mattes: such a capture is one of plain photographs.
fn drop_opaque_alpha(photos: &mut [Photo], notes: &mut Vec<String>) {
    let with_alpha = photos.iter().filter(|p| p.channels == 4).count();
    let transparent = |p: &Photo| p.channels == 4 && p.pixels.chunks_exact(4).any(|px| px[3] < 255);
    if with_alpha == 0 || photos.par_iter().any(transparent) {
        return;
    }
    photos.par_iter_mut().filter(|p| p.channels == 4).for_each(|p| {
        p.pixels = p.pixels.chunks_exact(4).flat_map(|px| [px[0], px[1], px[2]]).collect();
        p.channels = 3;
    });
    notes.push(format!("the alpha channel of {with_alpha} images is opaque everywhere and was ignored"));
}

/// Points in another frame than the poses are the commonest mistake of exporters: most points should be inside several images.
fn check_cloud(cloud: &Cloud, photos: &[Photo], notes: &mut Vec<String>) {
    let step = cloud.position.len().div_ceil(4096).max(1);
    let sample: Vec<&[f32; 3]> = cloud.position.iter().step_by(step).collect();
    let views = photos.len().min(3);
    let seen = |x: &&&[f32; 3]| photos.iter().filter(|p| inside(&p.camera, x)).take(views).count() == views;
    let share = sample.iter().filter(seen).count() as f64 / sample.len().max(1) as f64;
    if share < 0.5 {
        let percent = 100.0 * share;
        notes.push(format!(
            "only {percent:.0} % of the points are inside {views} or more images: points and poses may be in different frames"
        ));
    }
}

fn inside(camera: &Camera, x: &[f32; 3]) -> bool {
    let p = camera.to_camera(*x);
    let [u, v] = camera.project(p);
    p[2] > 0.0 && u >= 0.0 && v >= 0.0 && u <= camera.width as f32 && v <= camera.height as f32
}

fn spread(photos: &[Photo]) -> f32 {
    let first = photos[0].camera.center();
    photos.iter().map(|p| vec3::norm(vec3::sub(p.camera.center(), first))).fold(0.0, f32::max)
}

/// Which views are for testing: what the capture says, else every n-th (§2.4).
fn test_flags(listing: &Listing, options: &Options, notes: &mut Vec<String>) -> Vec<bool> {
    let n = options.eval_every as usize;
    let mut flags: Vec<bool> = match n {
        0 => vec![false; listing.views.len()],
        _ => listing.views.iter().enumerate().map(|(i, v)| v.test.unwrap_or(i % n == 0)).collect(),
    };
    if flags.iter().all(|t| *t) {
        notes.push("too few views to set some aside: all of them are trained on and none is left to test with".into());
        flags.fill(false);
    }
    flags
}
