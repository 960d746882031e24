//! Surface nets: one vertex for every sheet of surface in a cell, one quad for every edge of the grid that the surface crosses
//! (Gibson 1998; splatting.md §7.7, step 3). The result is a closed manifold: every edge belongs to two triangles.

use rayon::prelude::*;

use super::cells::Cells;
use super::patches::{NONE, Patches, TABLE, TWICE, edge_corner, patches};
use super::volume::{EDGE, Volume};

/// A cell that the surface passes through.
struct Crossed {
    /// Number of its first vertex among the block's.
    first: u16,
    patches: Patches,
}

/// The vertices of one block.
#[derive(Default)]
struct Sheet {
    vertices: Vec<[f32; 3]>,
    cells: Vec<Crossed>,
    /// Position in `cells` of each cell of the block.
    index: Vec<u16>,
}

/// A mesh in voxel units.
#[derive(Default)]
pub(crate) struct Net {
    pub vertices: Vec<[f32; 3]>,
    pub triangles: Vec<[u32; 3]>,
}

/// Extracts the zero set. `refine` gets every vertex (mean of the crossings of its sheet) and returns where it shall be.
pub(crate) fn surface_net(volume: &Volume, cells: &Cells, refine: impl Fn([f32; 3]) -> [f32; 3] + Sync) -> Net {
    let sheets: Vec<Sheet> = (0..volume.blocks.len()).into_par_iter().map(|b| sheet(volume, cells, b, &refine)).collect();
    let mut first = Vec::with_capacity(sheets.len());
    let mut count = 0u32;
    for s in &sheets {
        first.push(count);
        count += s.vertices.len() as u32;
    }
    let mut net = Net { vertices: Vec::with_capacity(count as usize), triangles: Vec::new() };
    sheets.iter().for_each(|s| net.vertices.extend_from_slice(&s.vertices));
    let quads: Vec<Vec<[u32; 3]>> =
        (0..volume.blocks.len()).into_par_iter().map(|b| triangles(volume, cells, b, &sheets, &first, &net.vertices)).collect();
    net.triangles = quads.concat();
    net
}

/// Inside bits of the 9³ corners of a block's cells, rows of nine.
fn corner_bits(volume: &Volume, cells: &Cells, b: usize) -> [u16; 81] {
    let block = &volume.blocks[b];
    let mut rows = [0u16; 81];
    for n in 0..8usize {
        let d = [n & 1, n >> 1 & 1, n >> 2];
        let coords: [i32; 3] = std::array::from_fn(|a| block.coords[a] + d[a] as i32);
        let found = if n == 0 { Some(b) } else { volume.find(coords) };
        let range = |d: usize| if d == 0 { 0..8 } else { 0..1 };
        let uniform = match found {
            Some(_) => 0,
            None => {
                if volume.value(cells, coords.map(|c| c * EDGE)) < 0.0 {
                    0xff
                } else {
                    0u8
                }
            }
        };
        for z in range(d[2]) {
            for y in range(d[1]) {
                let bits = found.map_or(uniform, |k| volume.blocks[k].inside[z * 8 + y]);
                let bits = if d[0] == 0 { u16::from(bits) } else { u16::from(bits & 1) << 8 };
                rows[(z + 8 * d[2]) * 9 + y + 8 * d[1]] |= bits;
            }
        }
    }
    rows
}

fn sheet(volume: &Volume, cells: &Cells, b: usize, refine: &(impl Fn([f32; 3]) -> [f32; 3] + Sync)) -> Sheet {
    let block = &volume.blocks[b];
    let rows = corner_bits(volume, cells, b);
    let mut out = Sheet::default();
    let node = block.coords.map(|c| c * EDGE);
    let table = &*TABLE;
    for z in 0..8 {
        for y in 0..8 {
            let r = [rows[z * 9 + y], rows[z * 9 + y + 1], rows[(z + 1) * 9 + y], rows[(z + 1) * 9 + y + 1]];
            let (any, all) = (r[0] | r[1] | r[2] | r[3], r[0] & r[1] & r[2] & r[3]);
            let mut mixed = (any | any >> 1) & !(all & all >> 1) & 0xff;
            while mixed != 0 {
                let x = mixed.trailing_zeros() as usize;
                mixed &= mixed - 1;
                let config = r.iter().enumerate().fold(0u8, |c, (k, r)| c | ((r >> x & 3) as u8) << (2 * k));
                let cell: [i32; 3] = [node[0] + x as i32, node[1] + y as i32, node[2] + z as i32];
                let sheets = match TWICE[config as usize] {
                    Some(face) if twice_too(volume, cells, cell, face) => patches(config, 1 << face),
                    _ => table[config as usize],
                };
                if out.index.is_empty() {
                    out.index.resize(512, u16::MAX);
                }
                out.index[(z * 8 + y) * 8 + x] = out.cells.len() as u16;
                out.cells.push(Crossed { first: out.vertices.len() as u16, patches: sheets });
                // Corner values: from the block itself wherever possible.
                let corner: [f32; 8] = std::array::from_fn(|k| {
                    let l = [x + (k & 1), y + (k >> 1 & 1), z + (k >> 2)];
                    if l[0] < 8 && l[1] < 8 && l[2] < 8 {
                        block.value[l[2] * 8 + l[1]][l[0]]
                    } else {
                        volume.value(cells, std::array::from_fn(|a| node[a] + l[a] as i32))
                    }
                });
                let mut sum = [([0.0f32; 3], 0.0f32); 4];
                for (e, p) in sheets.of.iter().enumerate().filter(|(_, p)| **p != NONE) {
                    let (lower, a) = (edge_corner(e), e / 4);
                    let (f, g) = (corner[lower], corner[lower | 1 << a]);
                    let s = &mut sum[*p as usize];
                    s.1 += 1.0;
                    for k in 0..3 {
                        s.0[k] += (lower >> k & 1) as f32 + if k == a { f / (f - g) } else { 0.0 };
                    }
                }
                for (at, n) in &sum[..sheets.count as usize] {
                    out.vertices.push(refine(std::array::from_fn(|k| cell[k] as f32 + at[k] / n)));
                }
            }
        }
    }
    out
}

/// True if the neighbour across a face passes twice through it as well.
fn twice_too(volume: &Volume, cells: &Cells, cell: [i32; 3], face: u8) -> bool {
    let (a, s) = (face as usize / 2, i32::from(face) % 2);
    let mut other = cell;
    other[a] += 2 * s - 1;
    let config = (0..8).fold(0u8, |c, k| {
        let node = [other[0] + (k & 1), other[1] + (k >> 1 & 1), other[2] + (k >> 2)];
        c | u8::from(volume.value(cells, node) < 0.0) << k
    });
    TWICE[config as usize] == Some(face ^ 1)
}

/// The triangles around the grid edges whose lower node is in block `b`.
fn triangles(volume: &Volume, cells: &Cells, b: usize, sheets: &[Sheet], first: &[u32], vertices: &[[f32; 3]]) -> Vec<[u32; 3]> {
    let block = &volume.blocks[b];
    let rows = corner_bits(volume, cells, b);
    let mut out = Vec::new();
    // Blocks below in each combination of axes, found when first needed.
    let mut below: [Option<Option<usize>>; 8] = [None; 8];
    below[0] = Some(Some(b));
    let mut vertex = |l: [i32; 3], edge: usize| -> Option<u32> {
        let n = (0..3).fold(0, |n, a| n | usize::from(l[a] < 0) << a);
        let k = (*below[n].get_or_insert_with(|| volume.find(std::array::from_fn(|a| block.coords[a] - i32::from(l[a] < 0)))))?;
        let l = l.map(|v| (v & 7) as usize);
        let sheet = &sheets[k];
        let cell = sheet.cells.get(*sheet.index.get((l[2] * 8 + l[1]) * 8 + l[0])? as usize)?;
        let p = cell.patches.of[edge];
        (p != NONE).then(|| first[k] + u32::from(cell.first) + u32::from(p))
    };
    for z in 0..8 {
        for y in 0..8 {
            let row = rows[z * 9 + y];
            let next = [row >> 1, rows[z * 9 + y + 1], rows[(z + 1) * 9 + y]];
            for a in 0..3 {
                let mut crossed = (row ^ next[a]) & 0xff;
                while crossed != 0 {
                    let x = crossed.trailing_zeros() as usize;
                    crossed &= crossed - 1;
                    let l = [x as i32, y as i32, z as i32];
                    let (p, q) = ((a + 1) % 3, (a + 2) % 3);
                    let mut corner = |i: i32, j: i32| {
                        let mut c = l;
                        c[p] -= i;
                        c[q] -= j;
                        vertex(c, a * 4 + i as usize + 2 * j as usize)
                    };
                    // Every cell around a crossed edge has a vertex: the active blocks were chosen for it.
                    let (Some(v0), Some(v1), Some(v2), Some(v3)) = (corner(1, 1), corner(0, 1), corner(0, 0), corner(1, 0)) else {
                        debug_assert!(false, "a cell at a crossed edge has no vertex");
                        continue;
                    };
                    // Counter-clockwise around the axis if the lower node is inside.
                    let [v0, v1, v2, v3] = if row >> x & 1 == 1 { [v0, v1, v2, v3] } else { [v0, v3, v2, v1] };
                    let distance = |s: u32, t: u32| {
                        let (s, t) = (vertices[s as usize], vertices[t as usize]);
                        (0..3).map(|k| (s[k] - t[k]) * (s[k] - t[k])).sum::<f32>()
                    };
                    if distance(v0, v2) <= distance(v1, v3) {
                        out.extend([[v0, v1, v2], [v0, v2, v3]]);
                    } else {
                        out.extend([[v0, v1, v3], [v1, v2, v3]]);
                    }
                }
            }
        }
    }
    out
}
