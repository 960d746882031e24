//! The field by its definition: double precision, all samples, no search structure.

use megas_math::{Vec3, vec3};

use super::{ImlsSettings, Samples};

pub(crate) struct Oracle {
    pub x: Vec<Vec3<f64>>,
    pub n: Vec<Vec3<f64>>,
    pub w: Vec<f64>,
    pub spacing: f64,
    pub settings: ImlsSettings,
}

pub(crate) struct Value {
    pub f: f64,
    pub g: Vec3<f64>,
    pub h: f64,
}

impl Oracle {
    pub fn new(samples: &Samples, settings: &ImlsSettings, spacing: f64) -> Self {
        let n = samples.position.len();
        Self {
            x: samples.position.iter().map(|p| vec3::cast(*p)).collect(),
            n: samples.normal.iter().map(|p| vec3::cast(*p)).collect(),
            w: if samples.weight.is_empty() { vec![1.0; n] } else { samples.weight.iter().map(|w| f64::from(*w)).collect() },
            spacing,
            settings: *settings,
        }
    }

    /// Median over all samples of the mean distance to the six nearest others.
    pub fn mean_spacing(samples: &Samples) -> f64 {
        let mut all: Vec<f64> = samples
            .position
            .iter()
            .map(|p| {
                let mut d: Vec<f64> =
                    samples.position.iter().map(|q| vec3::norm(vec3::sub(vec3::cast::<f32, f64>(*p), vec3::cast(*q)))).collect();
                d.sort_by(f64::total_cmp);
                d[1..7].iter().sum::<f64>() / 6.0
            })
            .collect();
        all.sort_by(f64::total_cmp);
        all[all.len() / 2]
    }

    pub fn bandwidth(&self, x: Vec3<f64>) -> f64 {
        let s = &self.settings;
        let mut d: Vec<f64> = self.x.iter().map(|p| vec3::norm(vec3::sub(x, *p))).collect();
        d.sort_by(f64::total_cmp);
        (f64::from(s.factor) * d[s.neighbour - 1]).clamp(f64::from(s.least) * self.spacing, f64::from(s.most) * self.spacing)
    }

    /// `trust` multiplies φ, for the robust refits.
    pub fn with_bandwidth(&self, x: Vec3<f64>, h: f64, trust: &dyn Fn(usize) -> f64) -> Value {
        let (mut phi, mut phis, mut g) = (0.0, 0.0, [0.0; 3]);
        let near = |i: usize| {
            let d = vec3::sub(x, self.x[i]);
            let r2 = vec3::dot(d, d);
            (r2 <= 9.0 * h * h).then(|| (d, self.w[i] * trust(i) * (-r2 / (h * h)).exp()))
        };
        for i in 0..self.x.len() {
            if let Some((d, p)) = near(i) {
                phi += p;
                phis += p * vec3::dot(self.n[i], d);
            }
        }
        let f = phis / phi;
        for i in 0..self.x.len() {
            if let Some((d, p)) = near(i) {
                let s = vec3::dot(self.n[i], d);
                for a in 0..3 {
                    g[a] += (p * self.n[i][a] - 2.0 / (h * h) * p * d[a] * (s - f)) / phi;
                }
            }
        }
        Value { f, g, h }
    }

    pub fn evaluate(&self, x: Vec3<f64>) -> Value {
        let h = self.bandwidth(x);
        let mut v = self.with_bandwidth(x, h, &|_| 1.0);
        if let Some(sigma) = self.settings.robust {
            for _ in 0..3 {
                let g = v.g;
                let next = self.with_bandwidth(x, h, &|i| {
                    let e = vec3::sub(self.n[i], g);
                    (-vec3::dot(e, e) / f64::from(sigma * sigma)).exp()
                });
                // The last fit that is valid counts.
                if vec3::norm(v.g) < 0.2 || vec3::norm(next.g) < 0.2 {
                    break;
                }
                v = next;
            }
        }
        v
    }

    /// Newton steps until the step is below `tolerance`; returns the place and the number of steps.
    pub fn project(&self, mut x: Vec3<f64>, tolerance: f64) -> (Vec3<f64>, usize) {
        for k in 0..20 {
            let v = self.evaluate(x);
            let step = vec3::scale(v.g, -v.f / vec3::dot(v.g, v.g));
            x = vec3::add(x, step);
            if vec3::norm(step) < tolerance {
                return (x, k);
            }
        }
        (x, 20)
    }
}
