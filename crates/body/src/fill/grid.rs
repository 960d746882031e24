//! The lattice of grid points that the filling classifies.

use megas_math::Vec3;

/// Cubic cells in the filling frame; the grid point of a cell is its centre. Values are stored with x fastest.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Grid {
    /// Lower corner of cell (0, 0, 0).
    pub origin: Vec3<f64>,
    /// Side of a cell Δ, in the units of the frame.
    pub spacing: f64,
    /// Cells along each axis.
    pub dims: [usize; 3],
}

impl Grid {
    /// The grid that covers `[min, max]` plus `margin`; its origin and its extent are whole multiples of `block` cells, so
    /// that blocks of `block³` cells are cells of a coarser lattice through the origin of the frame.
    pub fn covering(min: Vec3<f64>, max: Vec3<f64>, margin: f64, spacing: f64, block: usize) -> Self {
        let coarse = spacing * block as f64;
        let lo: Vec3<i64> = std::array::from_fn(|k| ((min[k] - margin) / coarse).floor() as i64);
        let hi: Vec3<i64> = std::array::from_fn(|k| ((max[k] + margin) / coarse).ceil() as i64);
        Self { origin: lo.map(|v| v as f64 * coarse), spacing, dims: std::array::from_fn(|k| (hi[k] - lo[k]).max(1) as usize * block) }
    }

    /// Number of cells.
    pub fn len(&self) -> usize {
        self.dims.iter().product()
    }

    /// True without cells.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Index of a cell.
    #[inline(always)]
    pub fn index(&self, c: [usize; 3]) -> usize {
        (c[2] * self.dims[1] + c[1]) * self.dims[0] + c[0]
    }

    /// The cell with this index.
    #[inline(always)]
    pub fn cell(&self, index: usize) -> [usize; 3] {
        let x = index % self.dims[0];
        let rest = index / self.dims[0];
        [x, rest % self.dims[1], rest / self.dims[1]]
    }

    /// Centre of a cell.
    #[inline(always)]
    pub fn center(&self, c: [usize; 3]) -> Vec3<f64> {
        std::array::from_fn(|k| self.coordinate(k, c[k]))
    }

    /// Coordinate of the `i`-th cell centre along `axis`.
    #[inline(always)]
    pub fn coordinate(&self, axis: usize, i: usize) -> f64 {
        self.origin[axis] + (i as f64 + 0.5) * self.spacing
    }

    /// The cell that contains a position, if the grid does.
    #[inline(always)]
    pub fn locate(&self, p: Vec3<f64>) -> Option<[usize; 3]> {
        let mut c = [0; 3];
        for k in 0..3 {
            let v = ((p[k] - self.origin[k]) / self.spacing).floor();
            if !(v >= 0.0 && v < self.dims[k] as f64) {
                return None;
            }
            c[k] = v as usize;
        }
        Some(c)
    }

    /// Volume of one cell.
    pub fn cell_volume(&self) -> f64 {
        self.spacing.powi(3)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn covers_the_box_and_stays_aligned() {
        let g = Grid::covering([-1.03, 0.2, 5.0], [1.1, 0.9, 7.7], 0.1, 0.05, 4);
        for k in 0..3 {
            let blocks = g.origin[k] / 0.2;
            assert!((blocks - blocks.round()).abs() < 1e-9 && g.dims[k].is_multiple_of(4));
            assert!(g.origin[k] <= [-1.13, 0.1, 4.9][k] && g.origin[k] + g.dims[k] as f64 * 0.05 >= [1.2, 1.0, 7.8][k] - 1e-12);
        }
        for i in [0, 17, g.len() - 1] {
            assert_eq!(g.index(g.cell(i)), i);
            assert_eq!(g.locate(g.center(g.cell(i))), Some(g.cell(i)));
        }
        assert_eq!(g.locate([0.0, 0.5, 4.0]), None);
    }
}
