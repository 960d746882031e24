//! The physics suite and golden comparisons as an integration crate
