//! Which file becomes a view of which size, and whether all of it fits the memory budget (splatting.md §2.4).

use std::path::{Path, PathBuf};

use rayon::prelude::*;

use crate::{
    CaptureError, Downscale, Options,
    error::{Fault, Result},
    listing::{Listed, Listing},
    optics::{Intrinsics, Size, whole_ratio},
    picture::{Header, probe},
    resample::Filter,
};

/// Width above which `Downscale::Auto` reduces \[px\].
const AUTO_WIDTH: u32 = 1600;

/// What to do with one photograph.
pub(crate) struct Job {
    pub image: PathBuf,
    pub header: Header,
    pub mask: Option<(PathBuf, Header)>,
    /// Of the stored image.
    pub intrinsics: Intrinsics,
    pub target: Size,
    pub filter: Filter,
}

/// Every job, in the order of the views, and how many may be worked on at once.
pub(crate) struct Plan {
    pub jobs: Vec<Job>,
    pub at_once: usize,
    /// Whether images that somebody had reduced already were taken.
    pub reduced: bool,
}

/// Plans the loading of all views; nothing but headers is read.
pub(crate) fn plan(folder: &Path, listing: &Listing, options: &Options, notes: &mut Vec<String>) -> Result<Plan> {
    let ready = reduced_images(listing, options, notes);
    let reduced = ready.is_some();
    let files = match ready {
        Some(files) => files,
        None => present_images(listing)?,
    };
    let masks: Vec<Option<PathBuf>> = listing.views.iter().map(|v| v.mask.clone().or_else(|| v.mask_beside(&listing.base))).collect();
    note_masks(listing, &masks, notes);
    let jobs: Vec<Result<Job>> = listing
        .views
        .par_iter()
        .zip(files)
        .zip(masks)
        .map(|((view, image), mask)| job(view, image, mask, if reduced { Downscale::Factor(1) } else { options.downscale }))
        .collect();
    // One by one, so that the error reported is that of the first view whatever thread met its own first.
    let jobs = jobs.into_iter().collect::<Result<Vec<_>>>()?;
    let scaled = listing.views.iter().zip(&jobs).filter(|(v, j)| stated_size(v).is_some_and(|s| s != j.header.size)).count();
    if scaled > 0 && !reduced {
        notes.push(format!("{scaled} images differ in size from what the poses say by an exact factor; their intrinsics were scaled"));
    }
    let at_once = fit(folder, &jobs, options, reduced)?;
    Ok(Plan { jobs, at_once, reduced })
}

fn stated_size(view: &Listed) -> Option<Size> {
    view.optics.size.map(|s| s.map(|v| v as u32))
}

/// All images of `images_r/`, if the options ask for a factor, the folder is there and complete, and the size that the
/// intrinsics refer to is known.
fn reduced_images(listing: &Listing, options: &Options, notes: &mut Vec<String>) -> Option<Vec<PathBuf>> {
    let Downscale::Factor(r @ 2..) = options.downscale else { return None };
    let folder = listing.base.join(format!("images_{r}"));
    if !folder.is_dir() {
        return None;
    }
    let found: Vec<Option<PathBuf>> = listing.views.iter().map(|v| v.reduced(&listing.base, r)).collect();
    let missing = found.iter().filter(|f| f.is_none()).count();
    if missing > 0 {
        notes.push(format!("{} lacks {missing} of {} images and was not used", folder.display(), found.len()));
        return None;
    }
    if listing.views.iter().any(|v| v.optics.needs_original() && !v.image.is_file()) {
        notes.push(format!("{} was not used: the size that the intrinsics refer to is not known", folder.display()));
        return None;
    }
    let fits = |(view, path): (&Listed, &Option<PathBuf>)| {
        let small = path.as_deref().and_then(|p| probe(p).ok()).map(|h| h.size);
        let large = stated_size(view).or_else(|| probe(&view.image).ok().map(|h| h.size));
        // Without the original there is nothing to compare with.
        large.is_none() || small.zip(large).is_some_and(|(s, l)| whole_ratio(l, s) == Some(r))
    };
    if !listing.views.iter().zip(&found).all(fits) {
        notes.push(format!("{} was not used: not all of its images are {r} times smaller than the poses say", folder.display()));
        return None;
    }
    found.into_iter().collect()
}

fn present_images(listing: &Listing) -> Result<Vec<PathBuf>> {
    let missing: Vec<&Listed> = listing.views.iter().filter(|v| !v.image.is_file()).collect();
    let Some(example) = missing.first() else {
        return Ok(listing.views.iter().map(|v| v.image.clone()).collect());
    };
    let shown = |v: &&Listed| v.image.strip_prefix(&listing.base).unwrap_or(&v.image).display().to_string();
    let reduced = [2, 4, 8].into_iter().find(|r| example.reduced(&listing.base, *r).is_some());
    let remedy = match reduced {
        Some(r) => format!("there is images_{r}/: use --downscale {r}"),
        None => format!("add the photographs or remove their entries from {}", listing.file.display()),
    };
    Err(CaptureError::MissingImages {
        folder: listing.base.clone(),
        missing: missing.len(),
        listed: listing.views.len(),
        first: missing.iter().take(3).map(shown).collect(),
        remedy,
    })
}

fn note_masks(listing: &Listing, masks: &[Option<PathBuf>], notes: &mut Vec<String>) {
    let without = masks.iter().filter(|m| m.is_none()).count();
    let folder = listing.base.join("masks");
    if without == masks.len() && folder.is_dir() {
        notes.push(format!("{}: no mask belongs to any view; masks are looked for as masks/<image name>.png", folder.display()));
    } else if without > 0 && without < masks.len() {
        notes.push(format!("{without} of {} views have no mask; all of their pixels count", masks.len()));
    }
}

fn job(view: &Listed, image: PathBuf, mask: Option<PathBuf>, downscale: Downscale) -> Result<Job> {
    let header = probe(&image)?;
    let original =
        if view.optics.size.is_none() && view.image.is_file() && view.image != image { probe(&view.image)?.size } else { header.size };
    let intrinsics = view.optics.resolve(original).and_then(|i| i.fitted_to(header.size)).map_err(|f| view.fault(f))?;
    let mask = mask.map(|path| probe(&path).map(|h| (path, h))).transpose()?;
    if let Some((path, h)) = &mask
        && whole_ratio(h.size, header.size).or(whole_ratio(header.size, h.size)).is_none()
    {
        let found = format!("a mask of {} × {} pixels", h.size[0], h.size[1]);
        let expected = format!("{} × {} pixels, like its image", header.size[0], header.size[1]);
        return Err(Fault::new(found, expected, "store the mask in the size of the photograph").at(path, "the mask"));
    }
    let (target, filter) = target(header.size, downscale);
    Ok(Job { image, header, mask, intrinsics, target, filter })
}

/// The size of the view and the filter that leads there.
pub(crate) fn target(size: Size, downscale: Downscale) -> (Size, Filter) {
    match downscale {
        Downscale::Factor(r) => (size.map(|v| ((f64::from(v) / f64::from(r)).round() as u32).max(1)), Filter::Area),
        Downscale::Auto if size[0] > AUTO_WIDTH => {
            let height = (f64::from(size[1]) * f64::from(AUTO_WIDTH) / f64::from(size[0])).round() as u32;
            let whole = size[0].is_multiple_of(AUTO_WIDTH) && size[1].is_multiple_of(size[0] / AUTO_WIDTH);
            ([AUTO_WIDTH, height.max(1)], if whole { Filter::Area } else { Filter::Lanczos3 })
        }
        Downscale::Auto => (size, Filter::Area),
    }
}

impl Job {
    /// Bytes that stay: colours and, where there may be one, the mask.
    fn lasting(&self, target: Size) -> u64 {
        let masked = self.mask.is_some() || !self.intrinsics.lens.is_straight();
        u64::from(target[0]) * u64::from(target[1]) * (self.header.channels as u64 + u64::from(masked))
    }

    /// Bytes while the photograph is worked on: decoding, the straightened copy, and two masks.
    fn working(&self) -> u64 {
        let mask = self.mask.as_ref().map_or(0, |(_, h)| h.peak_bytes + 2 * self.header.pixels());
        let copies = if self.intrinsics.lens.is_straight() { 0 } else { self.header.channels as u64 + 3 };
        self.header.peak_bytes + copies * self.header.pixels() + mask
    }
}

/// How many photographs may be in work at once; an error with a way out if not even one.
fn fit(folder: &Path, jobs: &[Job], options: &Options, reduced: bool) -> Result<usize> {
    let lasting: u64 = jobs.iter().map(|j| j.lasting(j.target)).sum();
    let working = jobs.iter().map(Job::working).max().unwrap_or(0).max(1);
    let budget = options.memory_budget_bytes;
    let need = lasting.saturating_add(working);
    if need <= budget {
        return Ok(((budget - lasting) / working).min(1 << 16) as usize);
    }
    let now = match options.downscale {
        Downscale::Factor(r) => r,
        Downscale::Auto => 1,
    };
    let of_factor = |r: u32| -> u64 { jobs.iter().map(|j| j.lasting(target(j.header.size, Downscale::Factor(r)).0)).sum() };
    // Images that are reduced already would be asked for anew, from files that have not been looked at: promise nothing then.
    let fitting = [2, 4, 8, 16, 32].into_iter().find(|r| !reduced && *r > now && of_factor(*r).saturating_add(working) <= budget);
    let remedy = match fitting {
        Some(r) => format!("--downscale {r} would fit"),
        None => "raise the budget, reduce the images or leave some out".to_owned(),
    };
    Err(CaptureError::OverBudget { folder: folder.to_path_buf(), need_bytes: need, budget_bytes: budget, remedy })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn targets() {
        assert_eq!(target([3200, 2000], Downscale::Auto), ([1600, 1000], Filter::Area));
        assert_eq!(target([3008, 2000], Downscale::Auto), ([1600, 1064], Filter::Lanczos3));
        assert_eq!(target([1600, 9000], Downscale::Auto).0, [1600, 9000]);
        assert_eq!(target([999, 3], Downscale::Factor(4)), ([250, 1], Filter::Area));
        assert_eq!(target([3, 3], Downscale::Factor(u32::MAX)).0, [1, 1]);
    }
}
