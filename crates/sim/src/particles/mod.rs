//! Everything a material point owns (simulation.md §1.1), as a structure of arrays.
//!
//! Positions are a node index and an `f32` offset from it, so that slow creep is not lost in a large coordinate. The
//! elastic gradient is kept as `F − I`, which resolves strains far below the rounding of 1 in bodies that hardly rotate.

mod sort;

use megas_math::{Mat3, mat3};
use megas_model::Points;
use rayon::prelude::*;

use crate::grid::Grid;
use crate::material::{Law, Material};
pub use sort::Block;

/// [`Particles::law`]: StVK with Hencky strain, Herschel–Bulkley flow above the yield stress.
pub const HENCKY: u8 = 0;
/// [`Particles::law`]: fixed corotated elasticity.
pub const FIXED_COROTATED: u8 = 1;
/// [`Particles::law`]: weakly compressible fluid; the stored gradient holds J in its first entry.
pub const FLUID: u8 = 2;
/// [`Particles::law`]: compressible neo-Hookean elasticity.
pub const NEO_HOOKEAN: u8 = 3;
/// [`Particles::law`]: neo-Hookean elasticity split into shear and volume.
pub const NEO_HOOKEAN_SPLIT: u8 = 4;
/// [`Particles::law`]: Hencky elasticity with von Mises yield and linear hardening.
pub const VON_MISES: u8 = 5;
/// [`Particles::law`]: Hencky elasticity with Drucker–Prager yield (sand).
pub const DRUCKER_PRAGER: u8 = 6;

/// Exponent γ of Tait's equation of state for liquids.
pub const TAIT_EXPONENT: f64 = 7.0;
/// Largest J of a fluid: beyond it the fluid opens instead of pulling (simulation.md §5.1).
pub const MAX_FLUID_J: f64 = 1.001;

/// Points keep at least this many nodes away from each face of the box (simulation.md §9.3).
pub const MARGIN: usize = 2;

/// Largest number of nodes per axis: a cell packs into 10 bits.
pub const MAX_NODES: usize = 1 << AXIS_BITS;
/// Bits per axis of a packed cell.
pub(crate) const AXIS_BITS: u32 = 10;
/// Mask of one axis of a packed cell.
pub(crate) const AXIS_MASK: u32 = (1 << AXIS_BITS) - 1;

/// Packs the nearest node of a point, x in the high bits.
#[inline(always)]
pub(crate) fn pack(c: [u32; 3]) -> u32 {
    (c[0] << (2 * AXIS_BITS)) | (c[1] << AXIS_BITS) | c[2]
}

/// Inverse of [`pack`].
#[inline(always)]
pub(crate) fn unpack(c: u32) -> [u32; 3] {
    [c >> (2 * AXIS_BITS), (c >> AXIS_BITS) & AXIS_MASK, c & AXIS_MASK]
}

/// Why points cannot become particles.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ParticleError {
    /// Arrays of different lengths.
    #[error("the point array `{0}` has {1} values for {2} points")]
    Length(&'static str, usize, usize),
    /// A point too close to a face of the simulation box, outside it, or not a number.
    #[error("point {id} at {position:?} m is not inside the simulation box, which needs {MARGIN} nodes around every point")]
    Outside {
        /// Identity of the point.
        id: u32,
        /// Its position \[m\].
        position: [f64; 3],
    },
    /// A material index without a material.
    #[error("point {id} uses material {material}, but the scene has only {count}")]
    Material {
        /// Identity of the point.
        id: u32,
        /// The index.
        material: u8,
        /// Number of materials.
        count: usize,
    },
    /// A grid beyond [`MAX_NODES`] per axis, or too small to hold a point.
    #[error("a grid of {0:?} nodes: every axis needs 8 to {MAX_NODES}")]
    Grid([usize; 3]),
}

/// All points. The public arrays have the length [`Particles::len`] and may be changed freely between substeps; never
/// resize one alone. [`Particles::sort`] permutes all of them together.
#[derive(Clone, Debug, PartialEq)]
pub struct Particles {
    grid: Grid,
    /// False once positions may have changed since the last sort.
    sorted: bool,
    blocks: Vec<Block>,
    pub(crate) cell: Vec<u32>,
    pub(crate) offset: [Vec<f32>; 3],
    pub(crate) velocity: [Vec<f32>; 3],
    pub(crate) affine: [Vec<f32>; 9],
    /// F − I.
    pub(crate) elastic: [Vec<f32>; 9],
    pub(crate) total: [Vec<f32>; 9],
    /// Mass \[kg\]; 0 makes a tracer, which only takes part in G2P.
    pub mass: Vec<f32>,
    /// Reference volume V⁰ \[m³\].
    pub volume: Vec<f32>,
    /// Shear modulus μ \[Pa\].
    pub shear: Vec<f32>,
    /// Bulk modulus K \[Pa\].
    pub bulk: Vec<f32>,
    /// Uniaxial yield stress σ_Y \[Pa\]; infinite = elastic.
    pub yield_stress: Vec<f32>,
    /// Herschel–Bulkley viscosity η \[Pa·s^h\]; 0 = rate-independent von Mises flow. Of a fluid its viscosity μ_v \[Pa·s\].
    pub viscosity: Vec<f32>,
    /// Flow exponent h, 0.2–2; of a fluid the exponent γ of its pressure, −1 for `p = K (1 − J)`.
    pub exponent: Vec<f32>,
    /// The law's own constant: hardening modulus H \[Pa\] of von Mises, slope α_f of Drucker–Prager, largest J of a fluid.
    pub law_constant: Vec<f32>,
    /// Volume gain of Drucker–Prager sand that is still to be closed, as a Hencky strain.
    pub volume_gain: Vec<f32>,
    /// Accumulated plastic strain √(2/3) Σ |Δe|.
    pub plastic_strain: Vec<f32>,
    /// Liquid mass fraction, 0–1.
    pub liquid: Vec<f32>,
    /// Specific enthalpy relative to the solid at the reference temperature \[J/kg\].
    pub enthalpy: Vec<f64>,
    /// Temperature gradient \[K/m\].
    pub temperature_gradient: Vec<[f32; 3]>,
    /// Outward unit normal of surface splats; zero inside.
    pub normal: Vec<[f32; 3]>,
    /// Rebase matrix accumulated since the last frame, row by row (simulation.md §7.5).
    pub rebase: Vec<[f32; 9]>,
    /// Constitutive law: [`HENCKY`], [`FIXED_COROTATED`], [`FLUID`], [`NEO_HOOKEAN`], [`NEO_HOOKEAN_SPLIT`], [`VON_MISES`] or
    /// [`DRUCKER_PRAGER`].
    pub law: Vec<u8>,
    /// Index into the scene's material list.
    pub material: Vec<u8>,
    /// `megas_model::Phase` as a number.
    pub phase: Vec<u8>,
    /// Object number, from 1.
    pub object: Vec<u16>,
    /// `megas_model::FLAG_*` bits.
    pub flags: Vec<u16>,
    /// Stable identity.
    pub id: Vec<u32>,
    /// On which side of which thin sheets it is: bit k on the side that the normal of sheet k points to, bit 16 + k on the other.
    pub(crate) sides: Vec<u32>,
}

/// Runs `$body` with `$a` bound to every per-point array in turn, each with its name.
macro_rules! each_array {
    ($p:expr, $refer:tt, $name:ident, $a:ident => $body:expr) => {{
        let Particles {
            grid: _, sorted: _, blocks: _, cell, offset, velocity, affine, elastic, total, mass, volume, shear, bulk,
            yield_stress, viscosity, exponent, law_constant, volume_gain, plastic_strain, liquid, enthalpy, temperature_gradient, normal, rebase, law,
            material, phase, object, flags, id, sides,
        } = $p;
        each_array!(@one $name, $a, $body; cell, mass, volume, shear, bulk, yield_stress, viscosity, exponent, law_constant, volume_gain,
            plastic_strain, liquid, enthalpy, temperature_gradient, normal, rebase, law, material, phase, object, flags, id, sides);
        each_array!(@many $refer, $name, $a, $body; offset, velocity, affine, elastic, total);
    }};
    (@one $name:ident, $a:ident, $body:expr; $($field:ident),*) => { $({ let $name = stringify!($field); let $a = $field; $body; })* };
    (@many shared, $name:ident, $a:ident, $body:expr; $($field:ident),*) => {
        $(for $a in $field.iter() { let $name = stringify!($field); $body; })*
    };
    (@many unique, $name:ident, $a:ident, $body:expr; $($field:ident),*) => {
        $(for $a in $field.iter_mut() { let $name = stringify!($field); $body; })*
    };
}
pub(crate) use each_array;

impl Particles {
    /// `count` points at node (0, 0, 0) with every array zero, F = I: the shell that a checkpoint fills.
    pub fn blank(grid: &Grid, count: usize) -> Self {
        let z = || vec![0.0f32; count];
        let mut p = Self {
            grid: *grid,
            sorted: false,
            blocks: Vec::new(),
            cell: vec![0; count],
            offset: std::array::from_fn(|_| z()),
            velocity: std::array::from_fn(|_| z()),
            affine: std::array::from_fn(|_| z()),
            elastic: std::array::from_fn(|_| z()),
            total: std::array::from_fn(|_| z()),
            mass: z(),
            volume: z(),
            shear: z(),
            bulk: z(),
            yield_stress: vec![f32::INFINITY; count],
            viscosity: z(),
            exponent: vec![1.0; count],
            law_constant: z(),
            volume_gain: z(),
            plastic_strain: z(),
            liquid: z(),
            enthalpy: vec![0.0; count],
            temperature_gradient: vec![[0.0; 3]; count],
            normal: vec![[0.0; 3]; count],
            rebase: vec![[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]; count],
            law: vec![HENCKY; count],
            material: vec![0; count],
            phase: vec![0; count],
            object: vec![0; count],
            flags: vec![0; count],
            id: vec![0; count],
            sides: vec![0; count],
        };
        for k in [0, 4, 8] {
            p.total[k].fill(1.0);
        }
        p
    }

    /// Points at rest with the mass and the cold-solid law of their materials, in the order given (until the first sort).
    /// Enthalpy stays 0: temperatures belong to the phase code.
    pub fn new(points: &Points, grid: &Grid, materials: &[Material]) -> Result<Self, ParticleError> {
        let n = points.len();
        let lengths = [
            ("volume", points.volume.len()),
            ("normal", points.normal.len()),
            ("material", points.material.len()),
            ("object", points.object.len()),
            ("flags", points.flags.len()),
            ("id", points.id.len()),
        ];
        if let Some(&(name, len)) = lengths.iter().find(|l| l.1 != n) {
            return Err(ParticleError::Length(name, len, n));
        }
        if grid.nodes.iter().any(|&m| !(8..=MAX_NODES).contains(&m)) {
            return Err(ParticleError::Grid(grid.nodes));
        }
        let mut p = Self::blank(grid, n);
        for i in 0..n {
            let (id, m) = (points.id[i], points.material[i]);
            let Some(material) = materials.get(usize::from(m)) else {
                return Err(ParticleError::Material { id, material: m, count: materials.len() });
            };
            let xi = grid.coordinate(points.position[i]);
            let inside = (0..3).all(|a| (MARGIN as f64 - 0.5..(grid.nodes[a] - MARGIN) as f64 - 0.5).contains(&xi[a]));
            if !inside {
                return Err(ParticleError::Outside { id, position: points.position[i] });
            }
            p.set_grid_coordinate(i, xi);
            p.volume[i] = points.volume[i];
            p.mass[i] = (f64::from(points.volume[i]) * material.density) as f32;
            p.set_law(i, material);
            p.normal[i] = points.normal[i];
            p.material[i] = m;
            p.object[i] = points.object[i];
            p.flags[i] = points.flags[i];
            p.id[i] = id;
        }
        Ok(p)
    }

    /// Gives point `i` the law and the cold-solid parameters of `material`.
    pub fn set_law(&mut self, i: usize, material: &Material) {
        let (_, eta, h) = material.melt.return_map_constants();
        let (law, viscosity, exponent, constant) = match material.law {
            Law::Hencky => (HENCKY, eta, h, 0.0),
            Law::FixedCorotated => (FIXED_COROTATED, 0.0, 1.0, 0.0),
            Law::NeoHookean => (NEO_HOOKEAN, 0.0, 1.0, 0.0),
            Law::NeoHookeanSplit => (NEO_HOOKEAN_SPLIT, 0.0, 1.0, 0.0),
            Law::VonMises => (VON_MISES, 0.0, 1.0, material.hardening),
            Law::DruckerPrager => (DRUCKER_PRAGER, 0.0, 1.0, material.friction_slope()),
            Law::Fluid => (FLUID, material.fluid_viscosity, TAIT_EXPONENT, MAX_FLUID_J),
        };
        self.law[i] = law;
        self.shear[i] = if law == FLUID { 0.0 } else { material.shear_modulus as f32 };
        self.bulk[i] = material.bulk_modulus as f32;
        self.yield_stress[i] = material.solid_yield_stress as f32;
        self.viscosity[i] = viscosity as f32;
        self.exponent[i] = exponent as f32;
        self.law_constant[i] = constant as f32;
    }

    /// Number of points.
    pub fn len(&self) -> usize {
        self.cell.len()
    }

    /// True without points.
    pub fn is_empty(&self) -> bool {
        self.cell.is_empty()
    }

    /// The grid in which the cells are counted.
    pub fn grid(&self) -> &Grid {
        &self.grid
    }

    /// Position \[m\].
    pub fn position(&self, i: usize) -> [f64; 3] {
        let xi = self.grid_coordinate(i);
        std::array::from_fn(|a| self.grid.origin[a] + self.grid.spacing * xi[a])
    }

    /// Moves a point; the position is clamped to the inside of the box.
    pub fn set_position(&mut self, i: usize, x: [f64; 3]) {
        let xi = self.grid.coordinate(x);
        self.set_grid_coordinate(i, xi);
    }

    /// Position in node units from node (0, 0, 0).
    #[inline]
    pub fn grid_coordinate(&self, i: usize) -> [f64; 3] {
        let c = unpack(self.cell[i]);
        std::array::from_fn(|a| f64::from(c[a]) + f64::from(self.offset[a][i]))
    }

    /// Positions of all points in node units; `out` is overwritten.
    pub fn grid_coordinates(&self, out: &mut Vec<[f64; 3]>) {
        out.clear();
        out.extend((0..self.len()).map(|i| self.grid_coordinate(i)));
    }

    fn set_grid_coordinate(&mut self, i: usize, xi: [f64; 3]) {
        let mut c = [0u32; 3];
        for a in 0..3 {
            let (lo, hi) = (MARGIN as f64, (self.grid.nodes[a] - 1 - MARGIN) as f64);
            let x = if xi[a].is_finite() { xi[a].clamp(lo - 0.5, hi + 0.4999) } else { lo };
            let node = x.round().clamp(lo, hi);
            c[a] = node as u32;
            self.offset[a][i] = (x - node) as f32;
        }
        self.cell[i] = pack(c);
        self.sorted = false;
    }

    /// Velocity \[m/s\].
    pub fn velocity(&self, i: usize) -> [f32; 3] {
        std::array::from_fn(|a| self.velocity[a][i])
    }

    /// Sets the velocity \[m/s\].
    pub fn set_velocity(&mut self, i: usize, v: [f32; 3]) {
        for a in 0..3 {
            self.velocity[a][i] = v[a];
        }
    }

    /// On which side of thin sheet `k` (their order among the colliders, 0–15) it is: 1 where the normal points to, −1 on the other
    /// side, 0 away from it.
    pub fn side(&self, i: usize, k: usize) -> i32 {
        let bits = self.sides[i].checked_shr(k as u32).unwrap_or(0);
        (bits & 1) as i32 - (bits >> 16 & 1) as i32
    }

    /// Affine velocity matrix C \[1/s\].
    pub fn affine(&self, i: usize) -> Mat3<f32> {
        read(&self.affine, i)
    }

    /// Sets C \[1/s\].
    pub fn set_affine(&mut self, i: usize, c: Mat3<f32>) {
        write(&mut self.affine, i, c);
    }

    /// Elastic deformation gradient F; of a fluid, which has only a volume, `J^{1/3} I`.
    pub fn elastic(&self, i: usize) -> Mat3<f32> {
        if self.law[i] == FLUID {
            return mat3::scale(mat3::identity(), (self.elastic[0][i] + 1.0).cbrt());
        }
        mat3::add(read(&self.elastic, i), mat3::identity())
    }

    /// Volume over reference volume: det F, and for sand also what it has opened by.
    pub fn volume_ratio(&self, i: usize) -> f32 {
        match self.law[i] {
            FLUID => self.elastic[0][i] + 1.0,
            DRUCKER_PRAGER => mat3::det(self.elastic(i)) * self.volume_gain[i].exp(),
            _ => mat3::det(self.elastic(i)),
        }
    }

    /// Sets F; of a fluid only its determinant is kept.
    pub fn set_elastic(&mut self, i: usize, f: Mat3<f32>) {
        if self.law[i] == FLUID {
            let j = mat3::det(f);
            return write(&mut self.elastic, i, [[j - 1.0, 0.0, 0.0], [0.0; 3], [0.0; 3]]);
        }
        write(&mut self.elastic, i, mat3::sub(f, mat3::identity()));
    }

    /// `F − I`, the stored form: exact where [`Particles::elastic`] rounds.
    pub fn displacement_gradient(&self, i: usize) -> Mat3<f32> {
        read(&self.elastic, i)
    }

    /// Sets `F − I`.
    pub fn set_displacement_gradient(&mut self, i: usize, h: Mat3<f32>) {
        write(&mut self.elastic, i, h);
    }

    /// Total (render) deformation gradient Fᴿ, unlimited.
    pub fn total(&self, i: usize) -> Mat3<f32> {
        read(&self.total, i)
    }

    /// Sets Fᴿ.
    pub fn set_total(&mut self, i: usize, f: Mat3<f32>) {
        write(&mut self.total, i, f);
    }

    /// Multiplies a change of reference `F_after⁻¹ F_before` into the rebase matrix (simulation.md §7.5); keeps the old
    /// one where the inverse does not exist.
    pub fn record_rebase(&mut self, i: usize, before: Mat3<f32>, after: Mat3<f32>) {
        self.rebase[i] = rebased(self.rebase[i], before, after);
    }

    /// Indices in the order of ascending identity.
    pub fn by_id(&self) -> Vec<u32> {
        let mut order: Vec<u32> = (0..self.len() as u32).collect();
        order.sort_unstable_by_key(|&i| self.id[i as usize]);
        order
    }

    /// Every array as raw bytes with its name, in a fixed order: the state for a checkpoint. Multi-component quantities
    /// appear once per component under the same name.
    pub fn arrays(&self) -> Vec<(&'static str, &[u8])> {
        let mut out: Vec<(&'static str, &[u8])> = Vec::new();
        each_array!(self, shared, name, a => out.push((name, bytemuck::cast_slice(a.as_slice()))));
        out
    }

    /// The same arrays for writing (restoring a checkpoint into [`Particles::blank`]).
    pub fn arrays_mut(&mut self) -> Vec<(&'static str, &mut [u8])> {
        self.sorted = false;
        let mut out: Vec<(&'static str, &mut [u8])> = Vec::new();
        each_array!(self, unique, name, a => out.push((name, bytemuck::cast_slice_mut(a.as_mut_slice()))));
        out
    }

    /// Takes over the state of `other` without allocating; both must have the same number of points.
    pub fn copy_from(&mut self, other: &Self) {
        if self.len() != other.len() {
            *self = other.clone();
            return;
        }
        self.grid = other.grid;
        self.blocks.clone_from(&other.blocks);
        let pairs: Vec<_> = self.arrays_mut().into_iter().zip(other.arrays()).collect();
        pairs.into_par_iter().for_each(|((_, to), (_, from))| to.copy_from_slice(from));
        self.sorted = other.sorted;
    }

    /// A hash of every bit of the state, independent of nothing: two runs agree bitwise or the hash differs.
    pub fn state_hash(&self) -> u64 {
        let mut h = 0xcbf2_9ce4_8422_2325u64;
        for (_, bytes) in self.arrays() {
            for chunk in bytes.chunks(8) {
                let mut word = [0u8; 8];
                word[..chunk.len()].copy_from_slice(chunk);
                h = megas_math::rng::mix(h ^ u64::from_le_bytes(word));
            }
        }
        h
    }

    /// Tells the next sort that positions may have changed.
    pub(crate) fn mark_moved(&mut self) {
        self.sorted = false;
    }
}

/// `F_after⁻¹ F_before B`, or `B` where that does not exist.
pub(crate) fn rebased(b: [f32; 9], before: Mat3<f32>, after: Mat3<f32>) -> [f32; 9] {
    let b64: Mat3<f64> = std::array::from_fn(|r| std::array::from_fn(|c| f64::from(b[3 * r + c])));
    let Some(inverse) = mat3::inverse(mat3::cast::<f32, f64>(after)) else { return b };
    let m = mat3::mul(mat3::mul(inverse, mat3::cast(before)), b64);
    if m.iter().flatten().all(|v| v.is_finite()) { std::array::from_fn(|k| m[k / 3][k % 3] as f32) } else { b }
}

#[inline(always)]
fn read(a: &[Vec<f32>; 9], i: usize) -> Mat3<f32> {
    std::array::from_fn(|r| std::array::from_fn(|c| a[3 * r + c][i]))
}

#[inline(always)]
fn write(a: &mut [Vec<f32>; 9], i: usize, m: Mat3<f32>) {
    for r in 0..3 {
        for c in 0..3 {
            a[3 * r + c][i] = m[r][c];
        }
    }
}
