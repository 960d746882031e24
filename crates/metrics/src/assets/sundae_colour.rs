//! The solid colour of the sundae and how glossy its parts are.

use megas_math::{Vec3, vec3};

use super::{
    light::Finish,
    noise::{cell, noise_at, smoothstep, specks},
    sundae::{Part, Sundae, waffle},
};

fn mix(a: [f32; 3], b: [f32; 3], t: f32) -> [f32; 3] {
    vec3::lerp(a, b, t.clamp(0.0, 1.0))
}

/// Unlit colour of `part` at `x`, display-referred sRGB.
pub fn albedo(_scene: &Sundae, x: Vec3<f32>, part: Part) -> [f32; 3] {
    match part {
        Part::Table => wood(x),
        Part::Bowl => biscuit(x),
        Part::Strawberry => strawberry(x),
        Part::Pistachio => pistachio(x),
        Part::Vanilla => vanilla(x),
        Part::Sauce => mix([0.215, 0.095, 0.045], [0.26, 0.125, 0.06], 0.5 + 0.6 * noise_at(x, 6.0, 40.0)),
        Part::Wafer => rolled_wafer(x),
        Part::Cherry => mix([0.66, 0.03, 0.05], [0.50, 0.015, 0.04], 0.5 + 0.8 * noise_at(x, 9.0, 41.0)),
    }
}

/// Gloss and translucency of a part.
pub fn finish(part: Part) -> Finish {
    match part {
        Part::Table => Finish { wrap: 0.0, gloss: 0.10, translucency: 0.0 },
        Part::Bowl | Part::Wafer => Finish { wrap: 0.1, gloss: 0.0, translucency: 0.15 },
        Part::Strawberry | Part::Pistachio | Part::Vanilla => Finish { wrap: 0.28, gloss: 0.0, translucency: 0.55 },
        Part::Sauce => Finish { wrap: 0.1, gloss: 1.0, translucency: 0.1 },
        Part::Cherry => Finish { wrap: 0.15, gloss: 1.0, translucency: 0.3 },
    }
}

fn strawberry(x: Vec3<f32>) -> [f32; 3] {
    let swirl = noise_at([x[0], x[1], x[2] * 1.8 + 0.2 * noise_at(x, 3.0, 50.0)], 4.5, 51.0);
    let c = mix([0.975, 0.72, 0.735], [0.935, 0.53, 0.585], 0.45 + 0.9 * swirl);
    let (bits, which) = specks(crumbled(x, 9.0), 0.20, 0.30);
    mix(c, if which > 0.4 { [0.80, 0.26, 0.33] } else { [0.74, 0.16, 0.22] }, 0.8 * smoothstep(0.0, 0.3, bits))
}

/// Coordinates for bits of fruit and nut at `frequency`, bent so that the bits are chunks rather than balls.
fn crumbled(x: Vec3<f32>, frequency: f32) -> Vec3<f32> {
    let bend = |seed: f32| 0.30 * noise_at(x, 2.6 * frequency, seed);
    [x[0] * frequency + bend(57.0), x[1] * frequency + bend(58.0), 1.3 * x[2] * frequency + bend(59.0)]
}

fn pistachio(x: Vec3<f32>) -> [f32; 3] {
    let swirl = noise_at(x, 4.0, 52.0);
    let c = mix([0.80, 0.86, 0.60], [0.70, 0.79, 0.47], 0.45 + 0.7 * swirl);
    let (bits, which) = specks(crumbled(x, 10.0), 0.26, 0.28);
    mix(c, if which > 0.6 { [0.56, 0.42, 0.24] } else { [0.48, 0.58, 0.25] }, 0.8 * smoothstep(0.0, 0.3, bits))
}

fn vanilla(x: Vec3<f32>) -> [f32; 3] {
    let c = mix([0.985, 0.935, 0.79], [0.97, 0.88, 0.68], 0.4 + 0.7 * noise_at(x, 4.0, 53.0));
    let (flecks, _) = specks(x.map(|v| v * 24.0), 0.035, 0.25);
    mix(c, [0.45, 0.30, 0.17], 0.6 * smoothstep(0.0, 0.4, flecks))
}

fn biscuit(x: Vec3<f32>) -> [f32; 3] {
    let toast = 0.5 + 0.5 * noise_at(x, 3.0, 54.0) + 0.35 * noise_at(x, 11.0, 55.0);
    let dimple = mix([0.94, 0.73, 0.43], [0.86, 0.60, 0.31], toast);
    let ridge = mix([0.86, 0.57, 0.27], [0.70, 0.41, 0.17], toast);
    let c = mix(dimple, ridge, waffle(x[2], x[1].atan2(x[0])) * smoothstep(0.02, 0.08, x[2]));
    mix(c, [0.60, 0.33, 0.13], 0.55 * smoothstep(0.44, 0.54, x[2]))
}

fn rolled_wafer(x: Vec3<f32>) -> [f32; 3] {
    // A spiral of cocoa around the roll; the axis is close enough to straight up for the azimuth about it to be the plain one.
    let t = (x[2] - 0.60) / 0.90;
    let p = [x[0] - (0.17 + 0.33 * t), x[1] - (0.16 + 0.28 * t)];
    let turn = p[1].atan2(p[0]) / std::f32::consts::TAU + 7.0 * x[2];
    let stripe = smoothstep(0.30, 0.24, (turn - turn.floor() - 0.5).abs());
    let base = mix([0.90, 0.70, 0.42], [0.82, 0.58, 0.30], 0.5 + noise_at(x, 8.0, 56.0));
    mix(base, [0.42, 0.23, 0.11], 0.9 * stripe)
}

/// Oak boards with rings, pores, seams and a tone of their own.
pub fn wood(x: Vec3<f32>) -> [f32; 3] {
    const BOARD: f32 = 0.474;
    let v = x[1] / BOARD + 0.5;
    let board = if x[2] > -0.2 { v.floor() } else { 20.0 };
    let id = board as i32;
    let tone = cell(id, 3, 7);
    // Every board is cut from another place of the log: an axis almost along x, somewhere below.
    let shift = [cell(id, 1, 1) * 20.0, cell(id, 2, 1) * 0.5 - 0.25, cell(id, 3, 1) * 0.4 + 0.25];
    let p = [x[0] * 0.16 + shift[0], x[1] - (board * BOARD) + shift[1], x[2] - shift[2] + 0.02 * x[0]];
    let bend = 0.10 * noise_at(p, 2.2, 60.0) + 0.012 * noise_at(p, 9.0, 61.0);
    let rings = (p[1] * p[1] + p[2] * p[2]).sqrt() + bend;
    let f = rings * 17.0;
    let f = f - f.floor();
    let late = smoothstep(0.35, 0.85, f) * smoothstep(1.0, 0.9, f);
    let fibre = noise_at([x[0] * 0.07 + shift[0], x[1], x[2]], 60.0, 62.0);
    let pores = smoothstep(0.25, 0.6, noise_at([x[0] * 0.05 + shift[0], x[1], x[2]], 95.0, 63.0));
    let mut c = mix([0.80, 0.63, 0.46], [0.72, 0.54, 0.37], tone);
    c = mix(c, [0.56, 0.38, 0.24], 0.5 * late);
    c = mix(c, [0.50, 0.35, 0.23], 0.22 * (0.5 + fibre) + 0.28 * pores);
    let seam = (v - v.floor() - 0.5).abs();
    let dark = if x[2] > -0.14 { smoothstep(0.488, 0.497, seam) } else { 0.0 };
    mix(c, [0.16, 0.09, 0.05], 0.8 * dark)
}
