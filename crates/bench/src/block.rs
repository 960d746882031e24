//! The block of particles that m1 moves and r1 covers.

/// How many particles.
#[derive(Clone, Copy, Debug, clap::ValueEnum)]
pub enum Size {
    #[value(name = "25k")]
    K25,
    #[value(name = "200k")]
    K200,
    #[value(name = "1m")]
    M1,
}

impl Size {
    /// Particles along each axis.
    pub fn sites(self) -> [usize; 3] {
        match self {
            Self::K25 => [25, 40, 25],
            Self::K200 => [50, 80, 50],
            Self::M1 => [100, 100, 100],
        }
    }
}
