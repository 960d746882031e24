//! Random points inside the visual hull of an object on a transparent background (splatting.md §2.5).
//!
//! An octree finds the cells that no view sees through; points are drawn from its leaves and tested against the mattes
//! themselves.

use megas_math::{
    Vec3,
    rng::{Rng, mix},
};
use rayon::prelude::*;

use super::{focus::focus, look::Look};

/// Levels of the octree: leaves are 1/64 of the cube.
const LEVELS: u32 = 6;
/// Longest side of the coarse mattes the octree looks at.
const COARSE: usize = 256;
/// Room of the first cube around what the views show at the distance of the focus.
const MARGIN: f32 = 1.5;
/// Shares of the views that may see through a point before it is given up: mattes or poses of a few may be off.
const FORGIVEN: [f32; 4] = [0.0, 0.02, 0.05, 0.1];
/// Draws per wanted point before fewer are taken.
const DRAWS: usize = 64;

/// At most `count` points that no view (or hardly any) sees through and that a quarter of the views have inside their image;
/// none if the mattes leave nothing.
pub(super) fn carve(looks: &[Look<'_>], count: usize, seed: u64) -> Vec<Vec3<f32>> {
    let Some(focus) = focus(looks) else { return Vec::new() };
    let half_shown = looks.iter().map(|l| {
        let c = l.camera;
        let (_, corner) = c.ray(0.0, 0.0);
        let along = (0..3).map(|k| corner[k] * c.rotation[2][k]).sum::<f32>().max(0.1);
        // Half diagonal of the image at the distance of the focus.
        focus.distance * (1.0 / (along * along) - 1.0).max(0.0).sqrt()
    });
    let half = MARGIN * half_shown.fold(0.0, f32::max).min(2.0 * focus.distance);
    let mattes: Vec<Matte<'_>> = looks.par_iter().map(Matte::new).collect();
    let needed = looks.len().div_ceil(4);
    for share in FORGIVEN {
        let rule = Rule { needed, forgiven: (share * looks.len() as f32) as usize };
        let leaves = leaves(&mattes, focus.point, half, &rule);
        let points = draw(looks, &leaves, half / (1 << LEVELS) as f32, &rule, count, seed);
        if !points.is_empty() {
            return points;
        }
    }
    Vec::new()
}

/// How many views must have a point inside their image, and how many may see through it.
struct Rule {
    needed: usize,
    forgiven: usize,
}

/// A matte reduced so that what may be opaque anywhere in a coarse pixel counts, with sums over rectangles.
struct Matte<'a> {
    look: &'a Look<'a>,
    /// Pixels of the matte per coarse pixel.
    block: usize,
    size: [usize; 2],
    /// Number of coarse pixels that may be opaque above and to the left, `(size[0] + 1) · (size[1] + 1)` of them.
    sums: Vec<u32>,
}

/// What a view says about a cell.
enum Verdict {
    /// The cell is wholly in front of transparent pixels.
    Through,
    /// The cell may hold something; the view shows at least a part of it.
    Maybe,
    /// The view does not show it.
    Unseen,
}

impl<'a> Matte<'a> {
    fn new(look: &'a Look<'a>) -> Self {
        let (w, h) = (look.camera.width as usize, look.camera.height as usize);
        let block = w.max(h).div_ceil(COARSE).max(1);
        let size = [w.div_ceil(block), h.div_ceil(block)];
        let mut coarse = vec![false; size[0] * size[1]];
        for i in 0..w * h {
            // A pixel that tells nothing may hide the object.
            let hidden = look.photo.mask.as_ref().is_some_and(|m| m[i] == 0);
            if hidden || look.opaque(i) {
                coarse[(i / w / block) * size[0] + i % w / block] = true;
            }
        }
        let stride = size[0] + 1;
        let mut sums = vec![0u32; stride * (size[1] + 1)];
        for y in 0..size[1] {
            let mut row = 0;
            for x in 0..size[0] {
                row += u32::from(coarse[y * size[0] + x]);
                sums[(y + 1) * stride + x + 1] = sums[y * stride + x + 1] + row;
            }
        }
        Self { look, block, size, sums }
    }

    /// Judges a cube by the rectangle its corners span: the image of a convex body in front of the camera is inside it.
    fn judge(&self, centre: Vec3<f32>, half: f32) -> Verdict {
        let camera = self.look.camera;
        let (mut lo, mut hi) = ([f32::INFINITY; 2], [f32::NEG_INFINITY; 2]);
        for corner in 0..8 {
            let x = [0, 1, 2].map(|k| centre[k] + if corner >> k & 1 == 1 { half } else { -half });
            let p = camera.to_camera(x);
            if p[2].is_nan() || p[2] <= 1e-3 * half {
                // Beside or behind the camera: nothing can be said. It counts as shown, for it may be in part.
                return Verdict::Maybe;
            }
            let uv = camera.project(p);
            (0..2).for_each(|a| (lo[a], hi[a]) = (lo[a].min(uv[a]), hi[a].max(uv[a])));
        }
        let (w, h) = (camera.width as f32, camera.height as f32);
        if !(lo[0] < w && lo[1] < h && hi[0] >= 0.0 && hi[1] >= 0.0) {
            return Verdict::Unseen;
        }
        if lo[0] < 0.0 || lo[1] < 0.0 || hi[0] >= w || hi[1] >= h {
            return Verdict::Maybe;
        }
        let first = lo.map(|v| v as usize / self.block);
        let end = [0, 1].map(|a| (hi[a] as usize / self.block + 1).min(self.size[a]));
        let at = |x: usize, y: usize| self.sums[y * (self.size[0] + 1) + x];
        let opaque = at(end[0], end[1]) + at(first[0], first[1]) - at(first[0], end[1]) - at(end[0], first[1]);
        if opaque == 0 { Verdict::Through } else { Verdict::Maybe }
    }
}

/// Centres of the leaves of the octree that may hold something.
fn leaves(mattes: &[Matte<'_>], centre: Vec3<f32>, half: f32, rule: &Rule) -> Vec<Vec3<f32>> {
    let keep = |x: Vec3<f32>, half: f32| {
        let (mut shown, mut through) = (0, 0);
        for m in mattes {
            match m.judge(x, half) {
                Verdict::Through => (through, shown) = (through + 1, shown + 1),
                Verdict::Maybe => shown += 1,
                Verdict::Unseen => {}
            }
            if through > rule.forgiven {
                return false;
            }
        }
        shown >= rule.needed
    };
    let mut cells = vec![centre];
    let mut size = half;
    for _ in 0..LEVELS {
        size *= 0.5;
        let children = |c: &Vec3<f32>| {
            let c = *c;
            (0..8).map(move |corner| [0, 1, 2].map(|k| c[k] + if corner >> k & 1 == 1 { size } else { -size }))
        };
        cells = cells.par_iter().flat_map_iter(children).filter(|x| keep(*x, size)).collect();
    }
    cells
}

/// Uniform points of the leaves that pass the test against the mattes at full resolution.
fn draw(looks: &[Look<'_>], leaves: &[Vec3<f32>], half: f32, rule: &Rule, count: usize, seed: u64) -> Vec<Vec3<f32>> {
    if leaves.is_empty() {
        return Vec::new();
    }
    let inside = |x: Vec3<f32>| {
        let (mut shown, mut through) = (0, 0);
        for l in looks {
            let Some(i) = l.pixel(x) else { continue };
            shown += 1;
            through += usize::from(!l.opaque(i));
            if through > rule.forgiven {
                return false;
            }
        }
        shown >= rule.needed
    };
    let candidate = |i: usize| {
        let mut rng = Rng::new(mix(seed) ^ i as u64);
        let c = leaves[rng.below(leaves.len())];
        let x = [0, 1, 2].map(|k| c[k] + half * rng.range(-1.0, 1.0) as f32);
        inside(x).then_some(x)
    };
    let mut points = Vec::with_capacity(count);
    let (mut next, last) = (0, count.saturating_mul(DRAWS));
    while points.len() < count && next < last {
        let end = next.saturating_add(count.max(1024)).min(last);
        points.extend((next..end).into_par_iter().filter_map(candidate).collect::<Vec<_>>());
        // A hull thinner than anything that a sample of this size would meet.
        if points.is_empty() && next >= 8 * count.max(1024) {
            break;
        }
        next = end;
    }
    points.truncate(count);
    points
}
