//! Density-field filling, the baseline of PhysGaussian (splatting.md §6.7): cells where the Gaussians themselves are dense are
//! filled, and cells that are walled in by dense ones. It presumes a model with Gaussians inside and finds little in a model
//! that consists of a skin.

use megas_math::{Mat3, Real, Vec3, mat3, svd, vec3};
use rayon::prelude::*;

use super::{FillReport, Filling, Grid, Shell, points_across};

/// Eigenvalues of a covariance are at least this, in squared longest sides of the object.
const LEAST_VARIANCE: f64 = 1e-8;
/// Layers of cells that one task sums up.
const SLAB: usize = 4;

/// Options of the baseline.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DensityField {
    /// Density ρ_d above which a cell is filled; 5 by default, published scenes use 2–100.
    pub dense: f32,
    /// Density ρ_s from which a cell walls in others; 3 by default, published scenes use 1.
    pub wall: f32,
}

impl Default for DensityField {
    fn default() -> Self {
        Self { dense: 5.0, wall: 3.0 }
    }
}

/// Sum over the Gaussians of opacity times the mean of their value at the corners of each cell. A Gaussian reaches
/// `⌈S_max / Δ⌉` cells in every direction. `side` is the longest side of the object.
pub fn density<T: Real>(shell: &Shell<T>, grid: &Grid, side: f64) -> Vec<f32> {
    struct Kernel {
        mean: Vec3<f64>,
        inverse: Mat3<f64>,
        opacity: f64,
        low: [usize; 3],
        high: [usize; 3],
    }
    let least = LEAST_VARIANCE * side * side;
    let kernels: Vec<Kernel> = (0..shell.len())
        .into_par_iter()
        .filter_map(|i| {
            let mean = vec3::cast::<T, f64>(shell.mean[i]);
            let home = grid.locate(mean)?;
            let (w, r) = svd::eigen_symmetric(mat3::cast::<T, f64>(shell.covariance[i]));
            let w = w.map(|v| v.max(least));
            let reach = (w[0].sqrt() / grid.spacing).ceil() as usize;
            Some(Kernel {
                mean,
                inverse: mat3::congruence(r, mat3::diag(w.map(f64::recip))),
                opacity: shell.opacity[i].f64(),
                low: home.map(|c| c.saturating_sub(reach)),
                high: std::array::from_fn(|k| (home[k] + reach + 1).min(grid.dims[k])),
            })
        })
        .collect();
    let [nx, ny, nz] = grid.dims;
    let slabs: Vec<Vec<f32>> = (0..nz.div_ceil(SLAB))
        .into_par_iter()
        .map(|s| {
            let (z0, z1) = (s * SLAB, ((s + 1) * SLAB).min(nz));
            let mut sum = vec![0.0f64; (z1 - z0) * nx * ny];
            let mut corner = Vec::new();
            for k in kernels.iter().filter(|k| k.low[2] < z1 && k.high[2] > z0) {
                let (low, high) = ([k.low[0], k.low[1], k.low[2].max(z0)], [k.high[0], k.high[1], k.high[2].min(z1)]);
                let n: [usize; 3] = std::array::from_fn(|a| high[a] - low[a] + 1);
                corner.clear();
                for c in 0..n[0] * n[1] * n[2] {
                    let c = [c % n[0], c / n[0] % n[1], c / (n[0] * n[1])];
                    let x: Vec3<f64> = std::array::from_fn(|a| grid.origin[a] + (low[a] + c[a]) as f64 * grid.spacing - k.mean[a]);
                    corner.push((-0.5 * vec3::dot(x, mat3::mul_vec(k.inverse, x))).exp());
                }
                for z in low[2]..high[2] {
                    for y in low[1]..high[1] {
                        for x in low[0]..high[0] {
                            let at = ((z - low[2]) * n[1] + y - low[1]) * n[0] + x - low[0];
                            let value: f64 = (0..8).map(|o| corner[at + (o & 1) + (o >> 1 & 1) * n[0] + (o >> 2) * n[0] * n[1]]).sum();
                            sum[((z - z0) * ny + y) * nx + x] += k.opacity * value / 8.0;
                        }
                    }
                }
            }
            sum.into_iter().map(|v| v as f32).collect()
        })
        .collect();
    slabs.concat()
}

/// Fills a grid: dense cells, and cells that have walls in five of the six axis directions (downward does not count) and an
/// odd number of entries into walls above them.
pub fn density_filling<T: Real>(shell: &Shell<T>, grid: Grid, side: f64, settings: &DensityField) -> Filling {
    let field = density(shell, &grid, side);
    let [nx, ny, nz] = grid.dims;
    let step = [1, nx, nx * ny];
    let wall = |i: usize| field[i] > settings.wall;
    let mut ahead = vec![0u8; grid.len()];
    let mut odd = vec![false; grid.len()];
    // Every line of cells is walked once in each direction.
    for axis in 0..3 {
        for start in (0..grid.len()).filter(|&i| grid.cell(i)[axis] == 0) {
            let line = |k: usize| start + k * step[axis];
            let n = grid.dims[axis];
            let (mut met, mut entries) = (false, 0u32);
            for k in (0..n).rev() {
                let i = line(k);
                ahead[i] += u8::from(met);
                if axis == 2 {
                    odd[i] = entries % 2 == 1;
                    // Seen from below: from an empty cell into this one.
                    entries += u32::from(wall(i) && (k == 0 || !wall(line(k - 1))));
                }
                met |= wall(i);
            }
            if axis < 2 {
                let mut met = false;
                for k in 0..n {
                    ahead[line(k)] += u8::from(met);
                    met |= wall(line(k));
                }
            }
        }
    }
    debug_assert_eq!(field.len(), nx * ny * nz);
    let inside: Vec<bool> = (0..grid.len()).map(|i| field[i] > settings.dense || (ahead[i] == 5 && odd[i])).collect();
    let interior = inside.iter().filter(|v| **v).count();
    let report = FillReport { voted: interior, interior, points_across: points_across(&grid, &inside), ..FillReport::default() };
    Filling { grid, inside, votes: ahead, per_particle: 1, report }
}

#[cfg(test)]
mod tests {
    use megas_math::rng::Rng;

    use super::*;

    fn grid(n: usize) -> Grid {
        Grid { origin: [-1.0; 3], spacing: 2.0 / n as f64, dims: [n; 3] }
    }

    #[test]
    fn densities_are_the_sums_of_their_definition() {
        let mut rng = Rng::new(9);
        let mut shell = Shell::<f64>::default();
        for _ in 0..60 {
            let r = megas_math::quat::to_mat3(std::array::from_fn(|_| rng.normal()));
            let s: Vec3<f64> = [rng.range(0.02, 0.3), rng.range(0.02, 0.2), 1e-6];
            let mean = std::array::from_fn(|_| rng.range(-0.95, 0.95));
            shell.push(mean, mat3::congruence(r, mat3::diag(s.map(|v| v * v))), [0.0; 3], rng.unit());
        }
        let g = grid(16);
        let field = density(&shell, &g, 2.0);
        for (i, &found) in field.iter().enumerate() {
            let c = g.cell(i);
            let mut sum = 0.0;
            for k in 0..shell.len() {
                let (w, r) = svd::eigen_symmetric(shell.covariance[k]);
                let w = w.map(|v| v.max(4e-8));
                let inverse = mat3::congruence(r, mat3::diag(w.map(f64::recip)));
                let home = g.locate(shell.mean[k]).unwrap();
                let reach = (w[0].sqrt() / g.spacing).ceil() as usize;
                if (0..3).any(|a| c[a].abs_diff(home[a]) > reach) {
                    continue;
                }
                for o in 0..8 {
                    let corner: Vec3<f64> = std::array::from_fn(|a| g.origin[a] + (c[a] + (o >> a & 1)) as f64 * g.spacing);
                    let d = vec3::sub(corner, shell.mean[k]);
                    sum += shell.opacity[k] * (-0.5 * vec3::dot(d, mat3::mul_vec(inverse, d))).exp() / 8.0;
                }
            }
            assert!((f64::from(found) - sum).abs() < 1e-6 * (1.0 + sum), "{i} {found} {sum}");
        }
    }

    #[test]
    fn walls_close_a_box_and_a_missing_bottom_is_forgiven() {
        // Small opaque blobs in every cell of the surface of a box of 6³ cells, twelve in each.
        for bottom in [true, false] {
            let g = grid(12);
            let mut shell = Shell::<f64>::default();
            for i in 0..g.len() {
                let c = g.cell(i);
                let within = (0..3).all(|k| (3..9).contains(&c[k]));
                let skin = (0..3).any(|k| c[k] == 3 || c[k] == 8);
                if within && skin && (bottom || c[2] != 3) {
                    for _ in 0..12 {
                        shell.push(g.center(c), mat3::diag([0.01; 3]), [0.0; 3], 1.0);
                    }
                }
            }
            let filling = density_filling(&shell, g, 1.0, &DensityField { dense: 5.0, wall: 7.0 });
            for i in 0..g.len() {
                let c = g.cell(i);
                let deep = (0..3).all(|k| (4..8).contains(&c[k]));
                let outside = (0..3).any(|k| c[k] < 2 || c[k] > 9);
                assert!(!deep || filling.inside[i], "{c:?}");
                assert!(!outside || !filling.inside[i], "{c:?}");
            }
        }
    }
}
