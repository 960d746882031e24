//! Views to splats that survive melting (splatting.md §5).
//!
//! [`Options`] says what is trained and how, [`initial_splats`] where it starts, and a [`Trainer`] does one iteration per
//! call of [`Trainer::step`]. Losses are in [`loss`], adding and removing Gaussians in `refine`, the optimiser in `adam`.

mod adam;
mod checkpoint;
mod colours;
mod exposure;
mod finetune;
pub mod loss;
mod model;
mod neighbour;
mod options;
mod refine;
mod trainer;

pub use adam::Rates;
pub use checkpoint::CheckpointError;
pub use exposure::ExposureRates;
pub use finetune::{FinetuneOptions, Teacher, split_needles};
pub use options::{Background, LearningRates, Mcmc, Method, Options, Profile, PruneEvent, Refinement, Region, Weights};
pub use refine::Refined;
pub use trainer::{StepReport, Trainer, initial_splats};
