//! One sweep over the points of a block: G2P of a substep, everything local to a point, and P2G of the next substep
//! (simulation.md §2.2, §2.4). Between the two a point never returns to memory.

use fearless_simd::{Bytes, Select, Simd, SimdBase, SimdFloat, SimdMask};
use megas_math::simd::transpose::{Record, load_records, store_records};
use megas_math::simd::{Lanes, Mat3s, each3, each6, each9};
use megas_math::{Mat3, mat3, svd};
use megas_model::{FLAG_ESCAPED, FLAG_REPAIRED};

use super::laws::{Flow, Laws, Mask, Parameters, advance_fluid, respond};
use super::sheets::Near;
use super::transfer::{CHUNK, Stencils, TILE, TILE_ORIGIN, Tile, complete_tracer, gather, scatter, weights};
use super::view::View;
use super::{Bounds, Repairs};
use crate::particles::{AXIS_BITS, AXIS_MASK, DRUCKER_PRAGER, FLUID, MARGIN, VON_MISES, pack, rebased, unpack};

/// Constants of a sweep.
#[derive(Clone, Copy)]
pub(crate) struct Sweep {
    /// Substep \[s\].
    pub dt: f32,
    /// Node spacing \[m\].
    pub dx: f32,
    /// Its inverse.
    pub inv_dx: f32,
    /// Largest speed a point may have \[m/s\].
    pub speed_cap: f32,
    /// Nodes per axis.
    pub nodes: [usize; 3],
    /// Share of the symmetric part of C that is removed each substep.
    pub affine_damping: f32,
    /// Node spacing as the lever of the affine momentum \[m\]; 0 leaves it out.
    pub lever: f32,
    /// Update Fᴿ.
    pub track_total: bool,
    /// Yue's μ̂.
    pub yue: bool,
    /// What happens at the faces of the box.
    pub bounds: Bounds,
    /// Points with less than this share of a full neighbourhood fly freely.
    pub isolation: f32,
}

/// What a sweep over one block found.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Outcome {
    pub repairs: Repairs,
    pub speed2: f32,
    pub volume: (f32, f32),
    /// Kinetic energy taken by the speed cap \[J\].
    pub removed: f64,
}

impl Outcome {
    pub const NEUTRAL: Self = Self { repairs: Repairs::NONE, speed2: 0.0, volume: (f32::INFINITY, 0.0), removed: 0.0 };

    /// Both findings together.
    pub fn merge(self, o: Self) -> Self {
        Self {
            repairs: self.repairs + o.repairs,
            speed2: self.speed2.max(o.speed2),
            volume: (self.volume.0.min(o.volume.0), self.volume.1.max(o.volume.1)),
            removed: self.removed + o.removed,
        }
    }
}

#[cold]
#[inline(never)]
fn tail<T: Copy>(slice: &[T], at: usize, fill: T) -> [T; CHUNK] {
    std::array::from_fn(|i| slice.get(at + i).copied().unwrap_or(fill))
}

/// Lanes `at..` of a slice; lanes past its end hold `fill`.
#[inline(always)]
fn load<S: Simd>(s: S, slice: &[f32], at: usize, fill: f32) -> Lanes<S> {
    let n = Lanes::<S>::LEN;
    match slice.get(at..at + n) {
        Some(full) => Lanes::<S>::from_slice(s, full),
        None => Lanes::<S>::from_slice(s, &tail(slice, at, fill)[..n]),
    }
}

#[inline(always)]
fn store<S: Simd>(v: Lanes<S>, slice: &mut [f32], at: usize) {
    let n = Lanes::<S>::LEN;
    match slice.get_mut(at..at + n) {
        Some(full) => v.store_slice(full),
        None => store_tail(v.as_slice(), &mut slice[at..]),
    }
}

#[cold]
#[inline(never)]
fn store_tail<T: Copy>(from: &[T], to: &mut [T]) {
    let n = to.len().min(from.len());
    to[..n].copy_from_slice(&from[..n]);
}

#[inline(always)]
fn load_cells<S: Simd>(s: S, slice: &[u32], at: usize) -> S::u32s {
    let n = <S::u32s as SimdBase<S>>::LEN;
    match slice.get(at..at + n) {
        Some(full) => S::u32s::from_slice(s, full),
        None => S::u32s::from_slice(s, &tail(slice, at, 0)[..n]),
    }
}

#[inline(always)]
fn load_matrix<S: Simd>(s: S, a: &[&mut [f32]; 9], at: usize) -> Mat3s<S> {
    each9(
        #[inline(always)]
        |r, c| load(s, a[3 * r + c], at, 0.0),
    )
}

#[inline(always)]
fn store_matrix<S: Simd>(m: &Mat3s<S>, a: &mut [&mut [f32]; 9], at: usize) {
    for k in 0..9 {
        store::<S>(m[k / 3][k % 3], a[k], at);
    }
}

/// `h + g + g h`, the displacement gradient after the increment `I + g`.
#[inline(always)]
fn advance<S: Simd>(g: &Mat3s<S>, h: &Mat3s<S>) -> Mat3s<S> {
    each9(
        #[inline(always)]
        |r, c| h[r][c] + g[r][0].mul_add(h[0][c], g[r][1].mul_add(h[1][c], g[r][2].mul_add(h[2][c], g[r][c]))),
    )
}

/// Stencils of `LEN` points, from the lane `at` of the chunk.
#[inline(always)]
fn fill_stencils<S: Simd>(s: S, st: &mut Stencils, at: usize, cell: S::u32s, g: [Lanes<S>; 3], corner: [u32; 3]) {
    let n = Lanes::<S>::LEN;
    let to = at..at + n;
    for (a, weights, levers) in [(0, &mut st.wx, &mut st.dx), (1, &mut st.wy, &mut st.dy)] {
        let lo = -g[a] + 0.5;
        let hi = g[a] + 0.5;
        let w = [lo * lo * 0.5, (g[a] * g[a]) * -1.0 + 0.75, hi * hi * 0.5];
        for k in 0..3 {
            w[k].store_slice(&mut weights[k][to.clone()]);
            (w[k] * (-g[a] + (k as f32 - 1.0))).store_slice(&mut levers[k][to.clone()]);
        }
    }
    g[2].store_slice(&mut st.gz[to.clone()]);
    // First stencil node in the tile: nearest node − 1 − (corner − TILE_ORIGIN). The clamp only guards the memory of the tile;
    // the drift rule of the driver keeps every point inside.
    let axis = |shift: u32, corner: u32| {
        let local = ((cell >> shift) & AXIS_MASK) - corner.wrapping_sub(TILE_ORIGIN - 1);
        local.min(S::u32s::splat(s, TILE as u32 - 3))
    };
    let x = axis(2 * AXIS_BITS, corner[0]);
    let y = axis(AXIS_BITS, corner[1]);
    let z = axis(0, corner[2]);
    ((((x << 3) + y) << 3) + z).store_slice(&mut st.first[to]);
}

/// Points of the block, one sweep. With `GATHER`, velocities are read from `from`, and points move and deform; with `SCATTER`
/// their momenta and stresses go to `to`, whose touched regions are returned. `near` is there for blocks that sheets run through.
#[inline(always)]
pub(crate) fn sweep<S: Simd, const GATHER: bool, const SCATTER: bool>(
    s: S,
    view: &mut View,
    from: &Tile,
    to: &mut Tile,
    mut near: Option<&mut Near>,
    k: &Sweep,
) -> (Outcome, u32) {
    let count = view.cell.len();
    let lanes = Lanes::<S>::LEN;
    let corner = view.block.coords.map(|c| c * 4);
    let splat = |v: f32| Lanes::<S>::splat(s, v);
    let zero = splat(0.0);
    let mut stencils = Stencils::ZERO;
    let mut records = [Record::ZERO; CHUNK];
    let mut outcome = Outcome::NEUTRAL;
    let mut regions = 0;
    let mut speed2 = zero;
    let (mut least_j, mut most_j) = (splat(f32::INFINITY), zero);
    for base in (0..count).step_by(CHUNK) {
        let valid = (count - base).min(CHUNK);
        if GATHER {
            for sub in (0..CHUNK).step_by(lanes) {
                let at = base + sub;
                let g = each3(
                    #[inline(always)]
                    |a| load(s, view.offset[a], at.min(count), 0.0),
                );
                let cell = load_cells(s, view.cell, at.min(count));
                fill_stencils(s, &mut stencils, sub, cell, g, corner);
            }
            let sides = &view.sides[base..base + valid];
            match near.as_deref().filter(|n| n.parts(&stencils, sides)) {
                None => gather(s, from, &stencils, valid, &mut records),
                Some(near) => near.gather(from, &stencils, sides, &mut records),
            }
            records[valid..].fill(Record::ZERO);
            for p in 0..valid {
                if view.mass[base + p] == 0.0 {
                    let node = |o: usize| near.as_deref().map_or(&from.0[o..o + 4], |n| n.value(from, sides[p], o));
                    if complete_tracer(node, &stencils, p, &mut records[p]) {
                        view.flags[base + p] |= FLAG_ESCAPED;
                    }
                }
            }
        }
        for sub in (0..CHUNK).step_by(lanes) {
            let at = base + sub;
            if at >= count {
                break;
            }
            let here = &mut records[sub..sub + lanes];
            let mass = load(s, view.mass, at, 0.0);
            let volume = load(s, view.volume, at, 0.0);
            let laws = Laws::new(&view.law[at..view.law.len().min(at + lanes)]);
            let plain = |used: bool, slice: &[f32]| if used { load(s, slice, at, 0.0) } else { zero };
            let law = Parameters {
                shear: load(s, view.shear, at, 0.0),
                bulk: load(s, view.bulk, at, 0.0),
                yield_stress: load(s, view.yield_stress, at, f32::INFINITY),
                viscosity: load(s, view.viscosity, at, 0.0),
                exponent: load(s, view.exponent, at, 1.0),
                constant: plain(laws.any(VON_MISES) | laws.any(DRUCKER_PRAGER) | laws.any(FLUID), view.constant),
                plastic: if GATHER { load(s, view.plastic, at, 0.0) } else { zero },
                gain: plain(laws.any(DRUCKER_PRAGER), view.gain),
            };
            let mut g = each3(
                #[inline(always)]
                |a| load(s, view.offset[a], at, 0.0),
            );
            let mut cell = load_cells(s, view.cell, at);
            let mut h = load_matrix(s, &view.elastic, at);
            let (v, c, isolated);
            if GATHER {
                let r = load_records(s, here);
                let motion = Motion::new(s, &r, k, mass, &mut outcome, lanes.min(count - at));
                (v, c) = (motion.velocity, motion.affine);
                speed2 = speed2.max(motion.speed2);
                // Free flight where Σ w m is a small part of ρ Δx³.
                let alone = (r[3] * volume).simd_lt(mass * (k.isolation * k.dx * k.dx * k.dx));
                isolated = alone;
                outcome.repairs.isolated += u64::from(alone.to_bitmask().count_ones());

                for a in 0..3 {
                    g[a] = v[a].mul_add(splat(k.dt * k.inv_dx), g[a]);
                }
                let shift = each3(|a| g[a].round_ties_even());
                for a in 0..3 {
                    g[a] -= shift[a];
                }
                let steps = each3(|a| shift[a].to_int::<S::i32s>());
                let delta = (((steps[0] << AXIS_BITS) + steps[1]) << AXIS_BITS) + steps[2];
                cell += delta.bitcast::<S::u32s>();
                keep_inside(s, view, at, lanes.min(count - at), &mut cell, &mut g, k, &mut outcome);
                for a in 0..3 {
                    store::<S>(g[a], view.offset[a], at);
                }
                match view.cell.get_mut(at..at + lanes) {
                    Some(full) => cell.store_slice(full),
                    None => store_tail(cell.as_slice(), &mut view.cell[at..]),
                }
                if !SCATTER {
                    for a in 0..3 {
                        store::<S>(v[a], view.velocity[a], at);
                    }
                    store_matrix::<S>(&c, &mut view.affine, at);
                }
                let step = alone.select(zero, splat(k.dt));
                let increment: Mat3s<S> = each9(|r, k| c[r][k] * step);
                if k.track_total {
                    let f = load_matrix(s, &view.total, at);
                    let f: Mat3s<S> = each9(
                        #[inline(always)]
                        |r, c| {
                            let t = increment[r][2].mul_add(f[2][c], f[r][c]);
                            increment[r][0].mul_add(f[0][c], increment[r][1].mul_add(f[1][c], t))
                        },
                    );
                    store_matrix::<S>(&f, &mut view.total, at);
                }
                let trial = advance::<S>(&increment, &h);
                h = if laws.any(FLUID) {
                    let (next, squeezed) = advance_fluid(s, &trial, &h, &increment, law.constant, laws.lanes(s, FLUID));
                    let valid = (1u64 << lanes.min(count - at)) - 1;
                    outcome.repairs.degenerate += u64::from((squeezed.to_bitmask() & valid).count_ones());
                    next
                } else {
                    trial
                };
            } else {
                v = each3(
                    #[inline(always)]
                    |a| load(s, view.velocity[a], at, 0.0),
                );
                c = load_matrix(s, &view.affine, at);
                isolated = Mask::<S>::splat(s, false);
            }
            let flow = if GATHER { Some(Flow { dt: k.dt, yue: k.yue }) } else { None };
            let r = respond(s, h, &c, &law, &laws, flow);
            let (mut stress, mut j) = (r.stress, r.volume);
            h = r.elastic;
            if r.degenerate.any_true() {
                let keep = !r.degenerate;
                stress = each6(|k| keep.select(stress[k], zero));
                j = keep.select(j, splat(1.0));
                repair(s, view, at, r.degenerate.to_bitmask(), &mut h, &mut outcome);
            }
            if GATHER {
                if r.plastic.simd_gt(zero).any_true() {
                    store::<S>(law.plastic + r.plastic, view.plastic, at);
                }
                if laws.any(DRUCKER_PRAGER) {
                    store::<S>(r.gain, view.gain, at);
                }
            }
            if GATHER {
                store_matrix::<S>(&h, &mut view.elastic, at);
                least_j = least_j.min(j);
                most_j = most_j.max(j);
            }
            if SCATTER {
                // A Δx = −Δt V⁰ (4/Δx) τ + m Δx C, columns per node spacing.
                let impulse = isolated.select(zero, volume * (-k.dt * 4.0 * k.inv_dx));
                let lever = mass * k.lever;
                let [xx, yy, zz, xy, xz, yz] = stress;
                let tau = [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]];
                let a = |r: usize, col: usize| impulse.mul_add(tau[r][col], lever * c[r][col]);
                let out = [
                    mass * v[0],
                    mass * v[1],
                    mass * v[2],
                    mass,
                    a(0, 0),
                    a(1, 0),
                    a(2, 0),
                    zero,
                    a(0, 1),
                    a(1, 1),
                    a(2, 1),
                    zero,
                    a(0, 2),
                    a(1, 2),
                    a(2, 2),
                    zero,
                ];
                store_records(s, &out, here);
                fill_stencils(s, &mut stencils, sub, cell, g, corner);
            }
        }
        if SCATTER {
            let sides = &view.sides[base..base + valid];
            regions |= match near.as_deref_mut().filter(|n| n.parts(&stencils, sides)) {
                None => scatter(s, to, &stencils, valid, &records),
                Some(near) => near.scatter(to, &stencils, sides, &records),
            };
        }
    }
    outcome.speed2 = speed2.reduce_max();
    outcome.volume = (least_j.reduce_min(), most_j.reduce_max());
    (outcome, regions)
}

/// Velocity and affine matrix out of a G2P record, capped and cleaned.
struct Motion<S: Simd> {
    velocity: [Lanes<S>; 3],
    affine: Mat3s<S>,
    speed2: Lanes<S>,
}

impl<S: Simd> Motion<S> {
    #[inline(always)]
    fn new(s: S, r: &[Lanes<S>; 16], k: &Sweep, mass: Lanes<S>, outcome: &mut Outcome, valid: usize) -> Self {
        let splat = |v: f32| Lanes::<S>::splat(s, v);
        let zero = splat(0.0);
        let mut v = [r[0], r[1], r[2]];
        let slope = splat(4.0 * k.inv_dx);
        let mut c: Mat3s<S> = each9(|row, col| r[4 + 4 * col + row] * slope);
        let mut speed2 = v[2].mul_add(v[2], v[1].mul_add(v[1], v[0] * v[0]));
        let mut size = speed2;
        for row in &c {
            size += row[0].abs() + row[1].abs() + row[2].abs();
        }
        // Also false for NaN.
        let finite = size.simd_lt(splat(1e30));
        if finite.any_false() {
            outcome.repairs.non_finite += u64::from((!finite).to_bitmask().count_ones()).min(valid as u64);
            v = each3(|a| finite.select(v[a], zero));
            c = each9(|i, j| finite.select(c[i][j], zero));
            speed2 = finite.select(speed2, zero);
        }
        let fast = speed2.simd_gt(splat(k.speed_cap * k.speed_cap));
        if fast.any_true() {
            outcome.repairs.capped += u64::from(fast.to_bitmask().count_ones());
            let cap2 = f64::from(k.speed_cap).powi(2);
            for lane in 0..valid {
                outcome.removed += 0.5 * f64::from(mass[lane]) * (f64::from(speed2[lane]) - cap2).max(0.0);
            }
            let scale = fast.select(splat(k.speed_cap) / speed2.sqrt(), splat(1.0));
            v = each3(|a| v[a] * scale);
            speed2 = speed2.min(splat(k.speed_cap * k.speed_cap));
        }
        if k.affine_damping > 0.0 {
            // C ← (1 − ζ) C + (ζ/2) (C − Cᵀ).
            let half = 0.5 * k.affine_damping;
            c = each9(|i, j| c[i][j] * (1.0 - half) - c[j][i] * half);
        }
        Self { velocity: v, affine: c, speed2 }
    }
}

/// Clamps points that reached the margin of the box, or tells that they left (simulation.md §9.3); rare, one lane at a time.
#[inline(always)]
fn keep_inside<S: Simd>(
    s: S,
    view: &mut View,
    at: usize,
    valid: usize,
    cell: &mut S::u32s,
    g: &mut [Lanes<S>; 3],
    k: &Sweep,
    outcome: &mut Outcome,
) {
    let margin = S::u32s::splat(s, MARGIN as u32);
    let mut out = 0u64;
    for a in 0..3 {
        let c = (*cell >> (AXIS_BITS * (2 - a as u32))) & AXIS_MASK;
        let last = S::u32s::splat(s, (k.nodes[a] - 1 - MARGIN) as u32);
        out |= (c.simd_lt(margin) | c.simd_gt(last)).to_bitmask();
    }
    out &= (1u64 << valid) - 1;
    while out != 0 {
        let lane = out.trailing_zeros() as usize;
        out &= out - 1;
        let mut c = unpack(cell[lane]);
        for a in 0..3 {
            let inside = c[a].clamp(MARGIN as u32, (k.nodes[a] - 1 - MARGIN) as u32);
            if inside != c[a] {
                g[a][lane] = if inside > c[a] { -0.5 } else { 0.5 };
                c[a] = inside;
            }
        }
        cell[lane] = pack(c);
        match k.bounds {
            Bounds::Clamp => outcome.repairs.out_of_box += 1,
            Bounds::Delete => view.flags[at + lane] |= FLAG_ESCAPED,
        }
    }
}

/// Replaces degenerate gradients by their rotation (simulation.md §7.6) and books the change of reference.
#[cold]
#[inline(never)]
fn repair<S: Simd>(_s: S, view: &mut View, at: usize, mut lanes: u64, h: &mut Mat3s<S>, outcome: &mut Outcome) {
    while lanes != 0 {
        let lane = lanes.trailing_zeros() as usize;
        lanes &= lanes - 1;
        let Some(flags) = view.flags.get_mut(at + lane) else { continue };
        // A tracer carries neither mass nor stress; resetting its gradient changes the shape of a splat and nothing that moves.
        if view.mass[at + lane] > 0.0 {
            *flags |= FLAG_REPAIRED;
            outcome.repairs.degenerate += 1;
        }
        let f: Mat3<f32> = std::array::from_fn(|r| std::array::from_fn(|c| h[r][c][lane] + f32::from(u8::from(r == c))));
        let finite = f.iter().flatten().all(|x| x.abs() < 1e15);
        // The stored gradient is the last valid one.
        let last: Mat3<f32> =
            std::array::from_fn(|r| std::array::from_fn(|c| view.elastic[3 * r + c][at + lane] + f32::from(u8::from(r == c))));
        let source = if finite { f } else { last };
        let rotation: Mat3<f32> = mat3::cast(svd::polar_rotation(mat3::cast::<f32, f64>(source)));
        if finite {
            view.rebase[at + lane] = rebased(view.rebase[at + lane], f, rotation);
        }
        for r in 0..3 {
            for c in 0..3 {
                h[r][c][lane] = rotation[r][c] - f32::from(u8::from(r == c));
            }
        }
    }
}

/// P2G of `[m f_l, 0, 0, m]`: how much of each node's mass is liquid. Once per sort, so one point at a time.
pub(crate) fn scatter_liquid(view: &View, to: &mut Tile, mut near: Option<&mut Near>) -> u32 {
    for (p, &packed) in view.cell.iter().enumerate() {
        let cell = unpack(packed);
        let m = view.mass[p];
        let w: [[f32; 3]; 3] = [0, 1, 2].map(|a| weights(view.offset[a][p]));
        let first: [usize; 3] = [0, 1, 2].map(|a| (cell[a] + TILE_ORIGIN - 1 - 4 * view.block.coords[a]) as usize);
        for i in 0..3 {
            for j in 0..3 {
                for k in 0..3 {
                    let weight = w[0][i] * w[1][j] * w[2][k] * m;
                    let o = (((first[0] + i) * TILE + first[1] + j) * TILE + first[2] + k) * 4;
                    match near.as_deref_mut() {
                        Some(near) => near.add(to, view.sides[p], o, [weight * view.liquid[p], 0.0, 0.0, weight]),
                        None => {
                            to.0[o] += weight * view.liquid[p];
                            to.0[o + 3] += weight;
                        }
                    }
                }
            }
        }
    }
    (1 << 27) - 1
}
