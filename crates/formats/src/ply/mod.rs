//! The PLY container: header (ascii, bounded) and rows (ascii, binary little or big endian).
//!
//! Rows of every encoding reach the caller as little-endian bytes at the offsets the header declares; a [`Column`] picks a
//! named property out of them. Nothing is allocated by what a header claims: claims are compared with the file's length first.

mod header;
mod rows;

pub(crate) use header::{Column, Element, Header, Kind};
pub(crate) use rows::{Row, for_each_block, next_row, skip};
