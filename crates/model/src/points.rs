//! Material points: what the simulator takes in and gives out (simulation.md §1.1, §7.5). SI units, simulator axes.

/// The point carries a surface splat.
pub const FLAG_SPLAT: u16 = 1;
/// The point was filled inside the body.
pub const FLAG_INTERNAL: u16 = 2;
/// The point left the simulation box and is hidden.
pub const FLAG_ESCAPED: u16 = 4;
/// The deformation gradient was repaired at least once.
pub const FLAG_REPAIRED: u16 = 8;

/// Points at rest, before the simulation. All arrays have the same length.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Points {
    /// Positions \[m\].
    pub position: Vec<[f64; 3]>,
    /// Reference volumes V⁰ \[m³\]; 0 makes a tracer.
    pub volume: Vec<f32>,
    /// Initial temperature \[K\].
    pub temperature: Vec<f32>,
    /// Outward unit normal of surface splats; zero inside.
    pub normal: Vec<[f32; 3]>,
    /// Index into the scene's material list.
    pub material: Vec<u8>,
    /// Object number, from 1.
    pub object: Vec<u16>,
    /// `FLAG_*` bits.
    pub flags: Vec<u16>,
    /// Stable identity, unique.
    pub id: Vec<u32>,
}

impl Points {
    /// Number of points.
    pub fn len(&self) -> usize {
        self.position.len()
    }

    /// True without points.
    pub fn is_empty(&self) -> bool {
        self.position.is_empty()
    }
}

/// The state of all points at one frame, ordered by ascending `id` (the order of the input when ids are 0, 1, 2 …).
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PointFrame {
    /// Time since the start \[s\].
    pub time: f64,
    /// Identities, ascending.
    pub id: Vec<u32>,
    /// Positions \[m\].
    pub position: Vec<[f32; 3]>,
    /// Elastic deformation gradient Fᴱ, row by row.
    pub elastic: Vec<[f32; 9]>,
    /// Limited total deformation gradient Fᴿ (simulation.md §7.3), row by row.
    pub total: Vec<[f32; 9]>,
    /// Rebase matrix accumulated since the previous frame (identity where nothing happened).
    pub rebase: Vec<[f32; 9]>,
    /// Transported outward normals of surface splats; zero inside.
    pub normal: Vec<[f32; 3]>,
    /// Temperature \[K\].
    pub temperature: Vec<f32>,
    /// Liquid mass fraction in [0, 1].
    pub liquid: Vec<f32>,
    /// Phase, see [`crate::Phase`].
    pub phase: Vec<u8>,
    /// `FLAG_*` bits.
    pub flags: Vec<u16>,
}
