//! What several tests share.
#![allow(missing_docs, dead_code)]

use std::path::PathBuf;

use megas_model::Splats;

/// A file of the shared data folder; `None` (with a message) where that folder is not checked out.
pub fn shared(name: &str) -> Option<PathBuf> {
    let path = PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/data")).join(name);
    if path.exists() {
        return Some(path);
    }
    eprintln!("skipped: {} is not there", path.display());
    None
}

/// A small congruential generator in [0, 1).
pub struct Numbers(pub u64);

impl Numbers {
    pub fn next(&mut self) -> f32 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 40) as f32 / (1u64 << 24) as f32
    }

    pub fn within(&mut self, lo: f32, hi: f32) -> f32 {
        lo + (hi - lo) * self.next()
    }
}

/// `n` different Gaussians with every attribute set to something of its own.
pub fn sample(degree: u8, n: usize) -> Splats {
    let mut r = Numbers(7 + u64::from(degree));
    let mut s = Splats { sh_degree: degree, ..Splats::default() };
    for _ in 0..n {
        let c: Vec<f32> = (0..s.sh_stride()).map(|k| if k < 3 { r.within(-1.7, 1.7) } else { r.within(-0.9, 0.9) }).collect();
        let q = [r.within(-1.0, 1.0), r.within(-1.0, 1.0), r.within(-1.0, 1.0), r.within(0.1, 1.0)];
        let mean = [r.within(-2.0, 3.0), r.within(0.0, 1.0), r.within(-9.0, -8.0)];
        s.push(mean, [r.within(-7.0, -3.0), r.within(-7.0, -3.0), r.within(-8.0, -2.0)], q, r.within(-6.0, 6.0), &c);
    }
    for i in 0..n {
        s.temperature[i] = 250.0 + i as f32 * 0.37;
        s.object_id[i] = (i * 7919 % 65536) as u16;
        s.phase[i] = (i % 4) as u8;
        s.origin[i] = (i % 3) as u8;
        s.normal_sign[i] = (i % 3) as i8 - 1;
        s.birth_id[i] = u32::MAX - 3 * i as u32;
    }
    s
}
