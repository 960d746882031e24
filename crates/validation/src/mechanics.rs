//! Being written.

use crate::Case;

/// The cases of this file.
pub const CASES: &[Case] = &[];
