//! Which of the paper's claims hold (splatting.md §9.4).

use megas_metrics::deform::Deformation;

use super::coherence::{self, Look};
use super::methods::{Contender, EXTREME, SHAPED};
use super::table::{Results, percent};
use crate::study::Check;

/// Most cracks of the full method, and most of those without its inside.
const CRACKS: f64 = 0.01;
const CRACKS_SHARE: f64 = 0.25;
/// Gain over plain splatting \[dB\].
const GAIN: f64 = 3.0;
/// Distance of meshes from the true surface \[L\].
const CHAMFER: f64 = 0.003;
/// Unrest of our mesh, in that of the density's.
const CALM: f64 = 0.5;
/// The filling.
const IOU: f64 = 0.9;
const HOLLOW: f64 = 0.02;
/// What a density field leaves hollow in a model that is only a skin.
const BASELINE_HOLLOW: f64 = 0.5;

fn millionths(x: f64) -> String {
    format!("{:.2} ppm", 1e6 * x)
}

fn decibel(x: f64) -> String {
    format!("{x:.2} dB")
}

/// All claims about deformed models and fillings that can be judged with what is there.
pub fn checks(r: &Results) -> Vec<Check> {
    use Contender::{A1, B0, B1, B2, B5, B6};
    let mut out = Vec::new();
    let mut say = |claim: String, holds: bool, numbers: String| out.push(Check { asset: r.name.clone(), claim, holds, numbers });
    let cracks = |m: Contender, d: Deformation| r.cracks(m, d, "crack_fraction");
    for d in EXTREME {
        let id = d.id();
        if let Some(full) = cracks(B6, d) {
            say(format!("{id} cracks: B6 at most {}", percent(CRACKS)), full <= CRACKS, percent(full));
            if let Some(plain) = cracks(B5, d) {
                let numbers = format!("{}, {}", percent(full), percent(plain));
                say(format!("{id} cracks: B6 at most a quarter of B5"), full <= CRACKS_SHARE * plain, numbers);
            }
        }
    }
    let mut chain = |what: &str, show: fn(f64) -> String, value: &dyn Fn(Contender) -> Option<f64>, order: &[&[Contender]], more: bool| {
        // Every method of a group must be better than every one of the next group that has any.
        let groups: Vec<Vec<(Contender, f64)>> =
            order.iter().map(|g| g.iter().filter_map(|&m| Some((m, value(m)?))).collect()).filter(|g: &Vec<_>| !g.is_empty()).collect();
        if groups.len() < 2 {
            return;
        }
        let better = |a: f64, b: f64| if more { a > b } else { a < b };
        let holds = groups.windows(2).all(|w| w[0].iter().all(|a| w[1].iter().all(|b| better(a.1, b.1))));
        let join = |f: &dyn Fn(&(Contender, f64)) -> String| {
            let group = |g: &Vec<(Contender, f64)>| g.iter().map(f).collect::<Vec<_>>().join(", ");
            groups.iter().map(group).collect::<Vec<_>>().join(if more { " > " } else { " < " })
        };
        out.push(Check {
            asset: r.name.clone(),
            claim: format!("{what}: {}", join(&|v| v.0.id().to_owned())),
            holds,
            numbers: join(&|v| show(v.1)),
        });
    };
    let order: [&[Contender]; 4] = [&[B6], &[B5], &[B2, B1], &[B0]];
    for d in EXTREME {
        chain(&format!("{} cracks", d.id()), percent, &|m| cracks(m, d), &order, false);
    }
    for d in SHAPED {
        chain(&format!("{} PSNR", d.id()), decibel, &|m| r.psnr(m, d), &order, true);
        chain(&format!("{} spill", d.id()), millionths, &|m| r.cracks(m, d, "spill"), &order, false);
    }
    let mut say = |claim: String, holds: bool, numbers: String| out.push(Check { asset: r.name.clone(), claim, holds, numbers });
    for d in SHAPED {
        if let (Some(ours), Some(plain)) = (r.psnr(B6, d), r.psnr(B0, d)) {
            let numbers = format!("{}, {}", decibel(ours), decibel(plain));
            say(format!("{} PSNR: B6 at least B0 + {GAIN} dB", d.id()), ours >= plain + GAIN, numbers);
        }
    }
    if let (Some(iou), Some(hollow)) = (r.filling(B5, "iou"), r.filling(B5, "hollow")) {
        say(format!("filling: IoU at least {IOU}"), iou >= IOU, format!("{iou:.3}"));
        say(format!("filling: hollow at most {}", percent(HOLLOW)), hollow <= HOLLOW, percent(hollow));
    }
    if let Some(chamfer) = r.mean(B5, "/meshes/skin/chamfer") {
        say(format!("mesh at rest: Chamfer at most {} L", percent(CHAMFER)), chamfer <= CHAMFER, percent(chamfer));
    }
    if let Some(chamfer) = r.mean(B5, "/meshes/skin/seen/chamfer") {
        say(format!("mesh at rest, what is photographed: Chamfer at most {} L", percent(CHAMFER)), chamfer <= CHAMFER, percent(chamfer));
    }
    for d in coherence::FILMS {
        let unrest = |l: Look, key: &str| r.mean(B6, &format!("/coherence/{}/{}/{key}", d.id(), l.names().0));
        for (look, what, key) in [
            (Look::Sealed, "pictures", "beyond_truth"),
            (Look::SkinMesh, "pictures", "beyond_truth"),
            (Look::SkinMesh, "normals", "normals_beyond_truth"),
        ] {
            if let (Some(ours), Some(other)) = (unrest(look, key), unrest(Look::DensityMesh, key)) {
                let claim = format!("{} film, unrest of {what}: {} at most half of the density's mesh", d.id(), look.names().1);
                say(claim, ours <= CALM * other, format!("{:.2}, {:.2} thousandths", 1e3 * ours, 1e3 * other));
            }
        }
    }
    if let Some(hollow) = r.filling(A1, "hollow") {
        say(
            format!("density field on our model: hollow at least {}", percent(BASELINE_HOLLOW)),
            hollow >= BASELINE_HOLLOW,
            percent(hollow),
        );
    }
    out
}
