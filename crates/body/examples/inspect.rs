//! Builds a body from a splat file, prints what happened and draws cross-sections of the filling:
//! `cargo run --release -p megas-body --example inspect -- donut.ply 0,0,1 [output folder [cells]]`.

use std::error::Error;
use std::path::PathBuf;

use megas_body::{BodySettings, Placement, Selection, build_body, orient::OrientSettings};

fn main() -> Result<(), Box<dyn Error>> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let [file, up, rest @ ..] = args.as_slice() else { return Err("usage: inspect FILE UPX,UPY,UPZ [FOLDER [CELLS]]".into()) };
    let up: Vec<f64> = up.split(',').map(str::parse).collect::<Result<_, _>>()?;
    let up: [f64; 3] = up.try_into().map_err(|_| "three components for up")?;
    let cells = rest.get(1).map_or(Ok(48), |c| c.parse())?;
    let loaded = megas_formats::load_splats(PathBuf::from(file))?;
    let settings = BodySettings {
        selection: Selection::All,
        placement: Placement::Size { up, size_m: 0.1, cells },
        orient: OrientSettings::default(),
        ..BodySettings::default()
    };
    let body = build_body(&loaded.splats, &settings)?;
    println!("{:#?}", body.report);
    if let Some(folder) = rest.first() {
        for axis in 0..3 {
            let (image, w, h) = section(&body, axis);
            let out = std::fs::File::create(PathBuf::from(folder).join(format!("section_{axis}.png")))?;
            let mut png = png::Encoder::new(out, w, h);
            png.set_color(png::ColorType::Rgb);
            png.write_header()?.write_image_data(&image)?;
        }
    }
    Ok(())
}

/// The middle layer across `axis`: white inside, grey by votes outside, red dots where surface Gaussians are.
fn section(body: &megas_body::Body, axis: usize) -> (Vec<u8>, u32, u32) {
    const ZOOM: usize = 6;
    let grid = &body.filling.grid;
    let (a, b) = [(1, 2), (0, 2), (0, 1)][axis];
    let (w, h) = (grid.dims[a] * ZOOM, grid.dims[b] * ZOOM);
    let mut image = vec![0u8; w * h * 3];
    let layer = grid.dims[axis] / 2;
    for y in 0..h {
        for x in 0..w {
            let mut c = [layer; 3];
            (c[a], c[b]) = (x / ZOOM, y / ZOOM);
            let i = grid.index(c);
            let v = if body.filling.inside[i] { 255 } else { body.filling.votes[i] * 24 };
            image[((h - 1 - y) * w + x) * 3..][..3].fill(v);
        }
    }
    let scale = body.similarity.metres_per_unit;
    for (p, _) in body.points.position.iter().zip(&body.points.flags).filter(|(_, f)| **f & megas_model::FLAG_SPLAT != 0) {
        let x = p.map(|v| v / scale);
        if (x[axis] - grid.coordinate(axis, layer)).abs() > grid.spacing {
            continue;
        }
        let at = |k: usize| ((x[k] - grid.origin[k]) / grid.spacing * ZOOM as f64) as usize;
        if at(a) < w && at(b) < h {
            image[((h - 1 - at(b)) * w + at(a)) * 3..][..3].copy_from_slice(&[220, 30, 30]);
        }
    }
    (image, w as u32, h as u32)
}
