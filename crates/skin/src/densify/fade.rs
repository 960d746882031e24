//! Which internal particles are shown, calmly (splatting.md §7.6): `hidden → in → shown → out → hidden` with hysteresis.

/// Scores at which a particle may come, must come at once, and must go. Behind an open crack the light is divided among all
/// particles along the way: where two fifths of it pass the skin, each gets a tenth and less.
const SHOW: f32 = 0.03;
const SHOW_AT_ONCE: f32 = 0.1;
const HIDE: f32 = 0.012;
/// Seconds that a particle must be unseen before it goes, and those of the two fades.
const PATIENCE_S: f32 = 0.25;
const FADE_IN_S: f32 = 1.0 / 6.0;
const FADE_OUT_S: f32 = 0.25;
/// Score from which the fade in is faster, in proportion: a crack that lets a fifth of the light in is sealed within a frame.
const HASTE: f32 = 0.05;
/// Seconds after which a hidden particle forgets its colour.
const MEMORY_S: f32 = 2.0;

/// The fade of one particle.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[repr(C)]
pub struct Fade {
    /// Opacity factor in [0, 1].
    pub amount: f32,
    /// Seconds since the score was last high enough to stay; while hidden, seconds since it was last shown.
    pub unseen_s: f32,
    /// Consecutive frames with a score high enough to come.
    pub seen: u16,
    /// 1 while the particle is wanted.
    pub wanted: u16,
}

impl Fade {
    /// A particle that was never shown.
    pub fn hidden() -> Self {
        Self { unseen_s: f32::INFINITY, ..Self::default() }
    }

    /// One frame of `dt` seconds with score `q`. `first`: the film begins, nothing fades.
    pub fn advance(&mut self, q: f32, dt: f32, first: bool, hysteresis: bool) {
        self.seen = if q >= SHOW { self.seen.saturating_add(1) } else { 0 };
        if !hysteresis || first {
            self.wanted = u16::from(q >= SHOW);
            self.amount = f32::from(self.wanted);
            self.unseen_s = if self.wanted == 1 { 0.0 } else { self.unseen_s + dt };
            return;
        }
        self.unseen_s = if q >= HIDE && self.wanted == 1 { 0.0 } else { self.unseen_s + dt };
        if self.wanted == 0 && (self.seen >= 2 || q >= SHOW_AT_ONCE) {
            (self.wanted, self.unseen_s) = (1, 0.0);
        } else if self.wanted == 1 && self.unseen_s > PATIENCE_S {
            self.wanted = 0;
        }
        let step = if self.wanted == 1 { dt / FADE_IN_S * (q / HASTE).max(1.0) } else { -dt / FADE_OUT_S };
        self.amount = (self.amount + step).clamp(0.0, 1.0);
    }

    /// Whether the kernel is drawn.
    pub fn is_drawn(&self) -> bool {
        self.amount > 0.0
    }

    /// Whether colour and shape of an earlier appearance still hold.
    pub fn remembers(&self) -> bool {
        self.unseen_s < MEMORY_S
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn short_glances_do_not_flicker_and_cracks_open_at_once() {
        let dt = 1.0 / 24.0;
        let mut f = Fade::hidden();
        let run = |f: &mut Fade, q: f32, frames: usize| (0..frames).for_each(|_| f.advance(q, dt, false, true));
        run(&mut f, 0.04, 1);
        assert!(!f.is_drawn());
        run(&mut f, 0.0, 1);
        run(&mut f, 0.04, 2);
        assert!((f.amount - 0.25).abs() < 1e-6);
        run(&mut f, 0.04, 3);
        assert_eq!(f.amount, 1.0);
        // Between the thresholds it stays; below for five frames too.
        run(&mut f, 0.02, 50);
        run(&mut f, 0.0, 5);
        run(&mut f, 0.02, 1);
        assert_eq!(f.amount, 1.0);
        run(&mut f, 0.0, 9);
        assert!(f.amount < 1.0 && f.amount > 0.0);
        run(&mut f, 0.0, 10);
        assert!(!f.is_drawn() && f.remembers());
        run(&mut f, 0.0, 50);
        assert!(!f.remembers());
        run(&mut f, 0.2, 1);
        assert_eq!(f.amount, 1.0);
        let mut g = Fade::hidden();
        g.advance(0.06, dt, true, true);
        assert_eq!(g.amount, 1.0);
        g.advance(0.0, dt, false, false);
        assert_eq!(g.amount, 0.0);
    }
}
