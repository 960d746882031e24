//! The splats under training with the optimiser's state and the statistics that refinement goes by.

use megas_model::Splats;
use megas_raster::Gradients;

use crate::adam::Adam;

/// Sums since the last refinement (splatting.md §4.5).
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Activity {
    /// Lengths of the gradient of the projected mean and of its absolute sum, in normalised device coordinates.
    pub gradient: Vec<[f32; 2]>,
    /// Views in which the Gaussian was drawn.
    pub views: Vec<u32>,
    /// Largest radius on the screen \[px\].
    pub radius: Vec<f32>,
}

impl Activity {
    pub fn reset(&mut self, n: usize) {
        self.gradient.clear();
        self.gradient.resize(n, [0.0; 2]);
        self.views.clear();
        self.views.resize(n, 0);
        self.radius.clear();
        self.radius.resize(n, 0.0);
    }

    pub fn add(&mut self, gradients: &Gradients) {
        for i in 0..self.views.len() {
            if gradients.visible(i) {
                self.gradient[i][0] += gradients.screen[i][0];
                self.gradient[i][1] += gradients.screen[i][1];
                self.views[i] += 1;
                self.radius[i] = self.radius[i].max(gradients.radius[i]);
            }
        }
    }

    /// Means over the views of Gaussian `i`.
    pub fn mean(&self, i: usize) -> [f32; 2] {
        let n = self.views[i].max(1) as f32;
        self.gradient[i].map(|g| g / n)
    }
}

/// Splats and everything that has one element per splat.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Model {
    pub splats: Splats,
    pub adam: Adam,
    pub activity: Activity,
}

impl Model {
    pub fn new(splats: Splats) -> Self {
        let adam = Adam::new(&splats);
        let mut activity = Activity::default();
        activity.reset(splats.len());
        Self { splats, adam, activity }
    }

    /// Keeps the splats for which `keep` holds; returns how many went.
    pub fn retain(&mut self, keep: impl Fn(usize) -> bool) -> usize {
        let n = self.splats.len();
        let indices: Vec<usize> = (0..n).filter(|&i| keep(i)).collect();
        if indices.len() < n {
            self.adam.select(&indices, self.splats.sh_stride());
            self.splats = self.splats.select(&indices);
            self.activity.gradient = indices.iter().map(|&i| self.activity.gradient[i]).collect();
            self.activity.views = indices.iter().map(|&i| self.activity.views[i]).collect();
            self.activity.radius = indices.iter().map(|&i| self.activity.radius[i]).collect();
        }
        n - indices.len()
    }

    /// Appends splats with zero moments.
    pub fn append(&mut self, new: &Splats) {
        self.splats.append(new);
        self.adam.grow(&self.splats);
        let n = self.splats.len();
        self.activity.gradient.resize(n, [0.0; 2]);
        self.activity.views.resize(n, 0);
        self.activity.radius.resize(n, 0.0);
    }

    /// Raises the degree of the spherical harmonics.
    pub fn raise_degree(&mut self, degree: u8) {
        if degree > self.splats.sh_degree {
            let old = self.splats.sh_stride();
            self.splats.set_degree(degree);
            self.adam.widen_sh(old, self.splats.sh_stride());
        }
    }
}
