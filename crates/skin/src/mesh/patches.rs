//! Which edges of a cell belong to the same sheet of the surface: one vertex for each sheet, so that the mesh is a manifold
//! also where two sheets pass through one cell (Nielson 2004, Dual Marching Cubes).
//!
//! Corners are numbered `x + 2y + 4z`; a configuration has a bit for every corner that is inside. Edge `4a + β + 2γ` runs
//! along axis `a` with β, γ the corner's bits along the next two axes. Face `2a + s` is the one with bit `s` along `a`.

use std::sync::LazyLock;

/// No patch.
pub(crate) const NONE: u8 = u8::MAX;

/// Sheets of one configuration.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Patches {
    /// Number of sheets, 0 to 4.
    pub count: u8,
    /// Sheet of each edge; [`NONE`] for edges without crossing.
    pub of: [u8; 12],
}

/// First corner of an edge; the second has the bit of the axis set as well.
#[inline(always)]
pub(crate) fn edge_corner(edge: usize) -> usize {
    let (a, k) = (edge / 4, edge % 4);
    (k & 1) << ((a + 1) % 3) | (k >> 1) << ((a + 2) % 3)
}

/// Edge between two corners that differ in one bit.
fn edge_between(p: usize, q: usize) -> usize {
    let a = (p ^ q).trailing_zeros() as usize;
    a * 4 + (p >> ((a + 1) % 3) & 1) + 2 * (p >> ((a + 2) % 3) & 1)
}

/// Corners of a face, around it.
fn face_corners(face: usize) -> [usize; 4] {
    let (a, s) = (face / 2, face % 2);
    let (b, c) = (1 << ((a + 1) % 3), 1 << ((a + 2) % 3));
    [0, b, b | c, c].map(|k| k | s << a)
}

/// True if the corners of the face alternate: two ways to connect its four crossings.
fn ambiguous(config: u8, face: usize) -> bool {
    let [a, b, c, d] = face_corners(face).map(|k| config >> k & 1);
    a == c && b == d && a != b
}

/// Sheets of a configuration. Where a face is ambiguous its inside corners are kept apart, or joined if the face's bit is
/// set in `joined`; both cells that share the face have to agree.
pub(crate) fn patches(config: u8, joined: u8) -> Patches {
    let mut root: [usize; 12] = std::array::from_fn(|e| e);
    fn find(root: &[usize; 12], mut e: usize) -> usize {
        while root[e] != e {
            e = root[e];
        }
        e
    }
    let inside = |k: usize| config >> k & 1 == 1;
    let crossed = |e: usize| inside(edge_corner(e)) != inside(edge_corner(e) | 1 << (e / 4));
    for face in 0..6 {
        let corner = face_corners(face);
        let side: [usize; 4] = std::array::from_fn(|k| edge_between(corner[k], corner[(k + 1) % 4]));
        let mut unite = |p: usize, q: usize| {
            let (p, q) = (find(&root, p), find(&root, q));
            root[p.max(q)] = p.min(q);
        };
        if ambiguous(config, face) {
            for k in 0..4 {
                if inside(corner[k]) != (joined >> face & 1 == 1) {
                    unite(side[(k + 3) % 4], side[k]);
                }
            }
        } else {
            let mut crossings = side.into_iter().filter(|e| crossed(*e));
            if let (Some(p), Some(q)) = (crossings.next(), crossings.next()) {
                unite(p, q);
            }
        }
    }
    let mut out = Patches { count: 0, of: [NONE; 12] };
    for e in 0..12 {
        if crossed(e) {
            let r = find(&root, e);
            if r == e {
                out.of[e] = out.count;
                out.count += 1;
            } else {
                out.of[e] = out.of[r];
            }
        }
    }
    out
}

/// Sheets of all configurations with no face joined.
pub(crate) static TABLE: LazyLock<Vec<Patches>> = LazyLock::new(|| (0..=255).map(|c| patches(c, 0)).collect());

/// The face of every configuration at which one sheet passes twice through an ambiguous face, if there is one. If the
/// neighbour across has it too, the two vertices would share an edge of four triangles; joining the face's inside corners
/// splits both sheets in two (Wenger 2013, Isosurfaces §4).
pub(crate) static TWICE: LazyLock<[Option<u8>; 256]> = LazyLock::new(|| {
    std::array::from_fn(|c| {
        let config = c as u8;
        (0..6usize)
            .find(|&f| {
                let corner = face_corners(f);
                let p = &TABLE[c];
                ambiguous(config, f)
                    && (0..4).all(|k| p.of[edge_between(corner[k], corner[(k + 1) % 4])] == p.of[edge_between(corner[0], corner[1])])
            })
            .map(|f| f as u8)
    })
});

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sheets_are_closed_loops_and_only_single_ambiguous_faces_are_passed_twice() {
        for c in 0..=255u8 {
            let p = TABLE[c as usize];
            let crossings = p.of.iter().filter(|k| **k != NONE).count();
            assert!(p.count <= 4 && (p.count == 0) == (c == 0 || c == 255) && crossings >= 3 * p.count as usize);
            for k in 0..p.count {
                assert!(p.of.iter().filter(|v| **v == k).count() >= 3);
            }
            if let Some(f) = TWICE[c as usize] {
                assert_eq!((0..6).filter(|f| ambiguous(c, *f)).count(), 1, "{c:08b}");
                // Joining splits the sheet, and the two halves do not meet on the face any more.
                let split = patches(c, 1 << f);
                assert_eq!(split.count, p.count + 1);
            }
        }
        assert!(TWICE.iter().flatten().count() > 0);
        // Two opposite corners: two sheets. The complement joins nothing either.
        assert_eq!((TABLE[0b1000_0001].count, TABLE[0b0111_1110].count), (2, 2));
        for e in 0..12 {
            assert_eq!(edge_between(edge_corner(e), edge_corner(e) | 1 << (e / 4)), e);
        }
    }
}
