//! Procedural bodies on a table, for scenes without a capture: simple solids and meshes in two colours, lit and sprinkled like
//! the demonstration. Everything outside this file is in metres, with z = 0 at the table top.

use std::sync::Arc;

use megas_geometry::Field;
use megas_math::{Mat3, Vec3, mat3, vec3};
use megas_model::Splats;

use super::light::{Finish, Light};
use super::noise::{noise_at, smoothstep, specks};
use super::primitives::disc;
use super::solid::Solid;
use super::sprinkle::{Fit, Lit, Sprinkle, cover};
use super::sundae::{TABLE_HEIGHT, TABLE_RADIUS, table};
use super::sundae_colour;

/// Geometry of a [`Thing`], around its centre; `half` are the half sides of its box.
#[derive(Clone, Debug)]
pub enum Form {
    /// Box.
    Box,
    /// Ellipsoid.
    Ball,
    /// Upright cylinder.
    Cylinder,
    /// Upright cone with a blunt tip.
    Cone,
    /// Lying ring.
    Torus,
    /// Distances of a mesh in units of the thing's own frame \[m\].
    Field(Arc<Field>),
}

/// How two colours mix.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mixture {
    /// Soft clouds.
    Marble,
    /// Chips of the second in the first.
    Speckle,
    /// Level layers.
    Layers,
    /// The first alone.
    Plain,
}

/// One body. Lengths in metres.
#[derive(Clone, Debug)]
pub struct Thing {
    /// Geometry.
    pub form: Form,
    /// Half sides of the box around it before it is turned.
    pub half: Vec3<f32>,
    /// Centre.
    pub center: Vec3<f32>,
    /// Rotation whose columns are the axes.
    pub axes: Mat3<f32>,
    /// Radius of rounded edges.
    pub rounding: f32,
    /// Two colours, display-referred sRGB.
    pub colours: [[f32; 3]; 2],
    /// How they mix.
    pub mixture: Mixture,
    /// Strength of the coat, 0–1.
    pub gloss: f32,
    /// Light that leaks through, 0–1.
    pub translucency: f32,
}

impl Thing {
    /// Signed distance \[m\].
    pub fn sdf(&self, x: Vec3<f32>) -> f32 {
        let p = mat3::tmul_vec(self.axes, vec3::sub(x, self.center));
        let [a, b, c] = self.half;
        let r = self.rounding;
        let rho = (p[0] * p[0] + p[1] * p[1]).sqrt();
        match &self.form {
            Form::Box => {
                let q: Vec3<f32> = std::array::from_fn(|k| p[k].abs() - (self.half[k] - r));
                vec3::norm(q.map(|v| v.max(0.0))) + q[0].max(q[1]).max(q[2]).min(0.0) - r
            }
            Form::Ball if a == b && b == c => vec3::norm(p) - a,
            Form::Ball => {
                // First order in the distance from the surface, which is where it counts.
                let u = vec3::norm([p[0] / a, p[1] / b, p[2] / c]);
                let g = vec3::norm([p[0] / (a * a), p[1] / (b * b), p[2] / (c * c)]);
                if g > 1e-9 { u * (u - 1.0) / g } else { -a.min(b).min(c) }
            }
            Form::Cylinder => disc(p, a, -c, c, r),
            Form::Cone => {
                // A triangle in the half plane of (ρ, z), drawn in by r and rounded by it.
                let slope = (2.0 * c).hypot(a);
                let (n_rho, n_z) = (2.0 * c / slope, a / slope);
                let side = (rho - a) * n_rho + (p[2] + c) * n_z + r;
                let floor = -c - p[2] + r;
                let (s, f) = (side.max(0.0), floor.max(0.0));
                // Their edges meet at an obtuse enough angle for the sum of squares to stand for the distance.
                (s * s + f * f).sqrt() + side.max(floor).min(0.0) - r
            }
            Form::Torus => ((rho - (a - c)).powi(2) + p[2] * p[2]).sqrt() - c,
            Form::Field(f) => megas_geometry::Shape::Field(Arc::clone(f)).distance(p.map(f64::from)).0 as f32,
        }
    }

    /// Half sides of the upright box around it.
    fn reach(&self) -> Vec3<f32> {
        std::array::from_fn(|r| (0..3).map(|c| self.axes[r][c].abs() * self.half[c]).sum())
    }

    /// Smallest and largest corner \[m\].
    pub fn bounds(&self) -> (Vec3<f32>, Vec3<f32>) {
        let r = self.reach();
        (vec3::sub(self.center, r), vec3::add(self.center, r))
    }

    /// Unlit colour at `x` \[m\], display-referred sRGB.
    pub fn albedo(&self, x: Vec3<f32>) -> [f32; 3] {
        let size = self.half[0].max(self.half[1]).max(self.half[2]).max(1e-6);
        let p = vec3::scale(mat3::tmul_vec(self.axes, vec3::sub(x, self.center)), 1.0 / size);
        let [first, second] = self.colours;
        let share = match self.mixture {
            Mixture::Plain => 0.0,
            Mixture::Marble => {
                let bend = noise_at(p, 1.7, 91.0);
                smoothstep(-0.5, 0.6, noise_at([p[0] + 0.4 * bend, p[1], p[2] - 0.4 * bend], 2.6, 92.0))
            }
            Mixture::Speckle => {
                let (bits, _) = specks(vec3::scale(p, 7.0), 0.24, 0.32);
                0.9 * smoothstep(0.0, 0.3, bits)
            }
            Mixture::Layers => smoothstep(-0.12, 0.12, (9.0 * (p[2] + 0.06 * noise_at(p, 2.0, 93.0))).sin()),
        };
        vec3::lerp(first, second, share)
    }

    fn finish(&self) -> Finish {
        Finish { wrap: 0.1 + 0.25 * self.translucency, gloss: self.gloss, translucency: self.translucency }
    }
}

/// Bodies and, if it is shown, the table.
pub struct StillLife {
    things: Vec<Thing>,
    table: bool,
    /// Metres per unit of the light, whose table has a fixed radius.
    unit: f32,
    light: Light,
}

/// The table or one body, in units of the light.
struct Piece<'a> {
    scene: &'a StillLife,
    /// Number from 1; 0 is the table.
    number: u16,
}

impl Solid for Piece<'_> {
    fn sdf(&self, x: Vec3<f32>) -> f32 {
        match self.thing() {
            Some(t) => t.sdf(self.scene.metres(x)) / self.scene.unit,
            None => table(x),
        }
    }

    fn bounds(&self) -> (Vec3<f32>, Vec3<f32>) {
        match self.thing() {
            Some(t) => {
                let (lo, hi) = t.bounds();
                (self.scene.units(lo), self.scene.units(hi))
            }
            None => ([-TABLE_RADIUS, -TABLE_RADIUS, -0.56], [TABLE_RADIUS, TABLE_RADIUS, TABLE_HEIGHT]),
        }
    }

    fn albedo(&self, x: Vec3<f32>) -> [f32; 3] {
        match self.thing() {
            Some(t) => t.albedo(self.scene.metres(x)),
            None => sundae_colour::wood(x),
        }
    }
}

impl Piece<'_> {
    fn thing(&self) -> Option<&Thing> {
        self.scene.things.get(usize::from(self.number).wrapping_sub(1))
    }
}

impl Lit for Piece<'_> {
    fn light(&self) -> &Light {
        &self.scene.light
    }

    fn look(&self, _: Vec3<f32>) -> (u16, Finish) {
        let wood = Finish { wrap: 0.0, gloss: 0.10, translucency: 0.0 };
        (self.number, self.thing().map_or(wood, Thing::finish))
    }

    fn colour(&self, x: Vec3<f32>, _: u16) -> [f32; 3] {
        self.albedo(x)
    }
}

impl StillLife {
    /// Bodies, and the radius \[m\] of the table, which also sets how far shadows are traced; `table` says whether it is shown.
    pub fn new(things: Vec<Thing>, table_radius: f32, show_table: bool) -> Self {
        let unit = table_radius / TABLE_RADIUS;
        let mut s = Self { things, table: show_table, unit, light: Light::empty() };
        let (mut lo, mut hi) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
        for t in &s.things {
            let (l, h) = t.bounds();
            (lo, hi) = (vec3::min(lo, s.units(l)), vec3::max(hi, s.units(h)));
        }
        if s.things.is_empty() {
            (lo, hi) = ([0.0; 3], [0.0; 3]);
        }
        let all = |x: Vec3<f32>| s.things.iter().fold(f32::INFINITY, |d, t| d.min(t.sdf(s.metres(x)) / s.unit));
        let light = match show_table {
            true => Light::new((lo, hi), all, table, (TABLE_HEIGHT, TABLE_RADIUS)),
            // Far below: it shades nothing.
            false => Light::new((lo, hi), all, |_| f32::INFINITY, (-1e6, 0.0)),
        };
        s.light = light;
        s
    }

    fn metres(&self, x: Vec3<f32>) -> Vec3<f32> {
        vec3::scale([x[0], x[1], x[2] - TABLE_HEIGHT], self.unit)
    }

    fn units(&self, x: Vec3<f32>) -> Vec3<f32> {
        vec3::add([0.0, 0.0, TABLE_HEIGHT], vec3::scale(x, 1.0 / self.unit))
    }

    /// One layer of discs on every body and on the table, positions and sizes in metres; `object_id` is the number of the body from
    /// 1, 0 for the table. `spacing` gives the least distance of two discs \[m\] per body; the table has `table_spacing`.
    pub fn sprinkle(&self, spacing: impl Fn(usize) -> f32, table_spacing: f32, settings: &Sprinkle) -> Splats {
        let fit = Fit::new(settings.sh_degree);
        let mut out = Splats { sh_degree: settings.sh_degree, ..Splats::default() };
        for number in 0..=self.things.len() as u16 {
            if number == 0 && !self.table {
                continue;
            }
            let metres = if number == 0 { table_spacing } else { spacing(usize::from(number) - 1) };
            let piece = Piece { scene: self, number };
            cover(&piece, metres / self.unit, settings.seed + u64::from(number), settings, &fit, &mut out);
        }
        let shrink = self.unit.ln();
        for x in &mut out.mean {
            *x = self.metres(*x);
        }
        for s in &mut out.log_scale {
            *s = s.map(|v| v + shrink);
        }
        out
    }

    /// The bodies.
    pub fn things(&self) -> &[Thing] {
        &self.things
    }

    /// Colour of the inside of body `index` at `x` \[m\] once it is exposed.
    pub fn interior_colour(&self, index: usize, x: Vec3<f32>) -> [f32; 3] {
        self.light.interior(self.things[index].albedo(x))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn thing(form: Form, half: Vec3<f32>) -> Thing {
        Thing {
            form,
            half,
            center: [0.0, 0.0, half[2]],
            axes: mat3::identity(),
            rounding: 0.1 * half[2],
            colours: [[0.8, 0.3, 0.2], [0.5, 0.2, 0.1]],
            mixture: Mixture::Marble,
            gloss: 0.3,
            translucency: 0.2,
        }
    }

    #[test]
    fn discs_lie_on_the_bodies_and_look_outwards() {
        let forms = [
            (Form::Box, [0.05, 0.04, 0.03]),
            (Form::Ball, [0.05, 0.05, 0.04]),
            (Form::Cylinder, [0.04, 0.04, 0.05]),
            (Form::Cone, [0.05, 0.05, 0.06]),
            (Form::Torus, [0.06, 0.06, 0.02]),
        ];
        for (form, half) in forms {
            let scene = StillLife::new(vec![thing(form, half)], 0.15, false);
            let splats = scene.sprinkle(|_| 0.004, 0.01, &Sprinkle::default());
            assert!(splats.len() > 500, "{:?} {}", scene.things[0].form, splats.len());
            for (i, x) in splats.mean.iter().enumerate() {
                let t = &scene.things[0];
                assert!(t.sdf(*x).abs() < 2e-4, "{:?} {x:?} {}", t.form, t.sdf(*x));
                let out = vec3::add_scaled(*x, vec3::normalize_or(vec3::sub(*x, t.center), [0.0, 0.0, 1.0]), 2e-3);
                assert!(matches!(t.form, Form::Torus) || t.sdf(out) > 5e-4, "{:?} {x:?}", t.form);
                assert!(splats.object_id[i] == 1 && splats.base_rgb(i).iter().all(|c| (0.0..=1.1).contains(c)));
                assert!((splats.log_scale[i][0].exp() - 0.7 * 0.004).abs() < 1e-5);
            }
        }
    }

    #[test]
    fn a_table_carries_the_bodies() {
        let scene = StillLife::new(vec![thing(Form::Ball, [0.04; 3])], 0.2, true);
        let splats = scene.sprinkle(|_| 0.005, 0.02, &Sprinkle::default());
        let top = |id: u16, f: fn(f32, f32) -> f32, from: f32| {
            splats.mean.iter().zip(&splats.object_id).filter(|p| *p.1 == id).fold(from, |a, p| f(a, p.0[2]))
        };
        assert!(top(0, f32::max, -1.0).abs() < 1e-3 && top(1, f32::min, 1.0).abs() < 2e-3);
        let dark = scene.interior_colour(0, [0.0, 0.0, 0.04]);
        assert!(dark.iter().all(|c| *c > 0.05 && *c < 1.0));
    }
}
