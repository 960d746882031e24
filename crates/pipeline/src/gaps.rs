//! Objects that start too close to each other: they share grid nodes and stick together (simulation.md §6.3).

use std::collections::{BTreeMap, HashMap};

use megas_model::Points;
use megas_scene::Severity;

/// Clearance in grid cells below which two objects weld at the start (`object_gap` of simulation.md §6.3).
const OBJECT_GAP: f64 = 1.5;

/// Distance of two points over their size from which on they lie inside each other: points that touch face to face are one size apart.
const INSIDE: f64 = 0.7;

/// What two objects have of each other at the start.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Gap {
    /// Clearance between the surfaces \[m\]; zero or less where they touch.
    pub(crate) clearance_m: f64,
    /// Points of the first object, and of the second, that lie in the other one.
    pub(crate) inside: [u32; 2],
}

/// All pairs of objects that start nearer to each other than `reach` metres, by their numbers.
pub(crate) fn gaps(points: &Points, reach: f64) -> BTreeMap<(u16, u16), Gap> {
    let edge = |p: usize| f64::from(points.volume[p]).cbrt();
    let largest = (0..points.position.len()).map(edge).fold(0.0, f64::max);
    // Points whose surfaces are within reach lie in neighbouring cells.
    let cell = reach + largest;
    let place = |p: usize| points.position[p].map(|x| (x / cell).floor() as i64);
    let mut cells: HashMap<[i64; 3], Vec<u32>> = HashMap::new();
    let solid = |p: &usize| points.volume[*p] > 0.0 && points.position[*p].iter().all(|x| x.is_finite());
    for p in (0..points.position.len()).filter(solid) {
        cells.entry(place(p)).or_default().push(p as u32);
    }
    // Cells of one object among cells of the same one are most of them.
    let single: HashMap<[i64; 3], Option<u16>> = cells
        .iter()
        .map(|(c, members)| {
            let first = points.object[members[0] as usize];
            (*c, members.iter().all(|p| points.object[*p as usize] == first).then_some(first))
        })
        .collect();
    let mut out: BTreeMap<(u16, u16), Gap> = BTreeMap::new();
    for p in (0..points.position.len()).filter(solid) {
        let (own, here) = (points.object[p], place(p));
        let mut inside: Vec<u16> = Vec::new();
        for n in 0..27 {
            let c = [here[0] + n / 9 - 1, here[1] + n / 3 % 3 - 1, here[2] + n % 3 - 1];
            if single.get(&c).is_none_or(|o| *o == Some(own)) {
                continue;
            }
            for q in cells.get(&c).into_iter().flatten().map(|q| *q as usize) {
                let other = points.object[q];
                if other == own {
                    continue;
                }
                let d = (0..3).map(|a| (points.position[p][a] - points.position[q][a]).powi(2)).sum::<f64>().sqrt();
                let size = 0.5 * (edge(p) + edge(q));
                if d - size >= reach {
                    continue;
                }
                let gap = out.entry((own.min(other), own.max(other))).or_insert(Gap { clearance_m: f64::INFINITY, inside: [0; 2] });
                gap.clearance_m = gap.clearance_m.min(d - size);
                if d < INSIDE * size && !inside.contains(&other) {
                    inside.push(other);
                    gap.inside[usize::from(own > other)] += 1;
                }
            }
        }
    }
    out
}

/// Share of an object's points in another one from which on somebody has put it there by mistake. Things that were photographed standing
/// on each other share a few.
const MISPLACED: f64 = 0.05;

/// Remarks about objects that start in each other or too close, with numbers and what to do: a warning where much of one lies in the
/// other, a note where they touch, as things that stand on each other do.
pub(crate) fn remarks(points: &Points, dx: f64, name: impl Fn(u16) -> String) -> Vec<(Severity, String)> {
    gaps(points, OBJECT_GAP * dx)
        .into_iter()
        .map(|((a, b), gap)| {
            let (first, second) = (name(a), name(b));
            let [i, j] = gap.inside;
            if i + j > 0 {
                let total = |o: u16| points.object.iter().filter(|p| **p == o).count() as f64;
                let share = (f64::from(i) / total(a)).max(f64::from(j) / total(b));
                let severity = if share > MISPLACED { Severity::Warning } else { Severity::Note };
                let text = format!(
                    "objects {first:?} and {second:?} start inside each other: {i} points of {first:?} ({:.1} %) and {j} of {second:?} ({:.1} %) share their \
                     place; matter is counted twice there and they stick together; move \
                     one of them by {:.1} mm or more",
                    100.0 * f64::from(i) / total(a),
                    100.0 * f64::from(j) / total(b),
                    1e3 * (OBJECT_GAP * dx - gap.clearance_m),
                );
                (severity, text)
            } else {
                let text = format!(
                    "objects {first:?} and {second:?} start {:.1} mm apart ({:.1} grid cells), less than {OBJECT_GAP} cells: they share grid nodes and \
                     stick together from the start; unless they are meant to, move them apart by {:.1} mm or use more cells",
                    1e3 * gap.clearance_m.max(0.0),
                    (gap.clearance_m / dx).max(0.0),
                    1e3 * (OBJECT_GAP * dx - gap.clearance_m),
                );
                (Severity::Note, text)
            }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two cubes of 8³ points of 1 mm, `gap` metres apart along x.
    fn cubes(gap: f64) -> Points {
        let mut points = Points::default();
        for object in 0..2u16 {
            for n in 0..512 {
                let x = [n / 64, n / 8 % 8, n % 8].map(|i| 1e-3 * (f64::from(i) + 0.5));
                points.position.push([x[0] + f64::from(object) * (8e-3 + gap), x[1], x[2]]);
                points.volume.push(1e-9);
                points.object.push(object + 1);
            }
        }
        points
    }

    #[test]
    fn clearance_is_that_between_the_surfaces() {
        for gap in [0.0, 1e-3, 2.5e-3] {
            let found = gaps(&cubes(gap), 3e-3);
            let g = found[&(1, 2)];
            assert!((g.clearance_m - gap).abs() < 1e-6 && g.inside == [0, 0], "{gap}: {g:?}");
        }
        assert!(gaps(&cubes(3.1e-3), 3e-3).is_empty());
    }

    #[test]
    fn overlap_is_counted_on_both_sides() {
        // Two of eight layers lie in the other cube.
        let g = gaps(&cubes(-2e-3), 3e-3)[&(1, 2)];
        assert_eq!(g.inside, [128, 128]);
        let (severity, text) = remarks(&cubes(-2e-3), 2e-3, |o| format!("cube {o}")).remove(0);
        assert_eq!(severity, Severity::Warning);
        assert!(text.contains("128 points of \"cube 1\" (25.0 %)"), "{text}");
    }

    #[test]
    fn remarks_say_how_far() {
        let (severity, text) = remarks(&cubes(1e-3), 2e-3, |o| format!("cube {o}")).remove(0);
        assert_eq!(severity, Severity::Note);
        assert!(text.contains("start 1.0 mm apart (0.5 grid cells)") && text.contains("apart by 2.0 mm"), "{text}");
        assert!(remarks(&cubes(1e-3), 0.5e-3, |o| o.to_string()).is_empty());
    }
}
