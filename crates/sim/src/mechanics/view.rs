//! The slices of one block of points that a substep reads and writes.

use std::mem::take;

use crate::particles::{Block, Particles};

/// All mechanical arrays of the points of one block.
pub(crate) struct View<'a> {
    pub block: Block,
    pub cell: &'a mut [u32],
    pub offset: [&'a mut [f32]; 3],
    pub velocity: [&'a mut [f32]; 3],
    pub affine: [&'a mut [f32]; 9],
    pub elastic: [&'a mut [f32]; 9],
    pub total: [&'a mut [f32]; 9],
    pub plastic: &'a mut [f32],
    pub gain: &'a mut [f32],
    pub flags: &'a mut [u16],
    pub rebase: &'a mut [[f32; 9]],
    pub mass: &'a [f32],
    pub volume: &'a [f32],
    pub shear: &'a [f32],
    pub bulk: &'a [f32],
    pub yield_stress: &'a [f32],
    pub viscosity: &'a [f32],
    pub exponent: &'a [f32],
    pub constant: &'a [f32],
    pub liquid: &'a [f32],
    pub law: &'a [u8],
    pub sides: &'a [u32],
}

fn cut_mut<'a, T>(s: &mut &'a mut [T], n: usize) -> &'a mut [T] {
    let (head, tail) = take(s).split_at_mut(n);
    *s = tail;
    head
}

fn cut<'a, T>(s: &mut &'a [T], n: usize) -> &'a [T] {
    let (head, tail) = s.split_at(n);
    *s = tail;
    head
}

/// Cuts the arrays of sorted particles at the block boundaries.
pub(crate) fn views(p: &mut Particles) -> Vec<View<'_>> {
    let blocks = p.blocks().to_vec();
    let Particles {
        cell,
        offset,
        velocity,
        affine,
        elastic,
        total,
        plastic_strain,
        flags,
        rebase,
        mass,
        volume,
        shear,
        bulk,
        yield_stress,
        viscosity,
        exponent,
        law_constant,
        volume_gain,
        liquid,
        law,
        sides,
        ..
    } = p;
    let mut cell = cell.as_mut_slice();
    let mut offset = offset.each_mut().map(Vec::as_mut_slice);
    let mut velocity = velocity.each_mut().map(Vec::as_mut_slice);
    let mut affine = affine.each_mut().map(Vec::as_mut_slice);
    let mut elastic = elastic.each_mut().map(Vec::as_mut_slice);
    let mut total = total.each_mut().map(Vec::as_mut_slice);
    let (mut constant, mut gain) = (law_constant.as_slice(), volume_gain.as_mut_slice());
    let (mut plastic, mut flags, mut rebase) = (plastic_strain.as_mut_slice(), flags.as_mut_slice(), rebase.as_mut_slice());
    let (mut mass, mut volume, mut shear, mut bulk) = (mass.as_slice(), volume.as_slice(), shear.as_slice(), bulk.as_slice());
    let (mut yield_stress, mut viscosity, mut exponent) = (yield_stress.as_slice(), viscosity.as_slice(), exponent.as_slice());
    let (mut liquid, mut law, mut sides) = (liquid.as_slice(), law.as_slice(), sides.as_slice());
    blocks
        .into_iter()
        .map(|block| {
            let n = (block.end - block.start) as usize;
            View {
                block,
                cell: cut_mut(&mut cell, n),
                offset: offset.each_mut().map(|a| cut_mut(a, n)),
                velocity: velocity.each_mut().map(|a| cut_mut(a, n)),
                affine: affine.each_mut().map(|a| cut_mut(a, n)),
                elastic: elastic.each_mut().map(|a| cut_mut(a, n)),
                total: total.each_mut().map(|a| cut_mut(a, n)),
                plastic: cut_mut(&mut plastic, n),
                gain: cut_mut(&mut gain, n),
                flags: cut_mut(&mut flags, n),
                rebase: cut_mut(&mut rebase, n),
                mass: cut(&mut mass, n),
                volume: cut(&mut volume, n),
                shear: cut(&mut shear, n),
                bulk: cut(&mut bulk, n),
                yield_stress: cut(&mut yield_stress, n),
                viscosity: cut(&mut viscosity, n),
                exponent: cut(&mut exponent, n),
                constant: cut(&mut constant, n),
                liquid: cut(&mut liquid, n),
                law: cut(&mut law, n),
                sides: cut(&mut sides, n),
            }
        })
        .collect()
}
