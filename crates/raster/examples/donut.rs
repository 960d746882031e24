//! Renders a splat file without spherical harmonics to a PPM image: `donut IN.ply OUT.ppm [azimuth_degrees]`.
//!
//! Reads only what it must of the ecosystem's binary `.ply` (every property a float); the real reader is `megas-formats`.

use megas_math::vec3;
use megas_model::{Camera, Splats};
use megas_raster::{Channels, Gaussians, Rasterizer, Settings};

fn read(path: &str) -> Result<Splats, Box<dyn std::error::Error>> {
    let bytes = std::fs::read(path)?;
    let marker = b"end_header\n";
    let end = bytes.windows(marker.len()).position(|w| w == marker).ok_or("no end of header")? + marker.len();
    let header = std::str::from_utf8(&bytes[..end])?;
    let names: Vec<&str> = header.lines().filter_map(|l| l.strip_prefix("property float ")).collect();
    let column = |name: &str| names.iter().position(|n| *n == name).ok_or_else(|| format!("no property {name}"));
    let mut at = Vec::new();
    for name in "x y z scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3 opacity f_dc_0 f_dc_1 f_dc_2".split(' ') {
        at.push(column(name)?);
    }
    let values: Vec<f32> = bytes[end..].as_chunks::<4>().0.iter().map(|b| f32::from_le_bytes(*b)).collect();
    let mut s = Splats::default();
    for row in values.chunks_exact(names.len()) {
        let v: Vec<f32> = at.iter().map(|&c| row[c]).collect();
        s.push([v[0], v[1], v[2]], [v[3], v[4], v[5]], [v[6], v[7], v[8], v[9]], v[10], &v[11..14]);
    }
    Ok(s)
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let args: Vec<String> = std::env::args().collect();
    let (input, output) = (args.get(1).ok_or("no input")?, args.get(2).ok_or("no output")?);
    let azimuth = args.get(3).map_or(Ok(30.0), |a| a.parse::<f32>())?.to_radians();
    let splats = read(input)?;
    let (lo, hi) = splats.bounds().ok_or("empty")?;
    let (center, radius) = (vec3::scale(vec3::add(lo, hi), 0.5), 0.5 * vec3::norm(vec3::sub(hi, lo)));
    let eye = vec3::add_scaled(center, [azimuth.cos(), azimuth.sin(), 0.7], 2.2 * radius);
    let camera = Camera::look_at(eye, center, [0.0, 0.0, 1.0], 0.6, 800, 600);
    let settings = Settings { background: [1.0; 3], ..Settings::default() };
    let g = Gaussians::from_splats(&splats);
    let frame = Rasterizer::new().frame(&g, &camera, &settings, Channels::Geometry);
    // Left to right: colour, normal, planar depth.
    let (w, h) = (frame.width as usize, frame.height as usize);
    let finite: Vec<f32> = frame.planar_depth.iter().copied().filter(|d| d.is_finite()).collect();
    let (near, far) = finite.iter().fold((f32::MAX, f32::MIN), |(a, b), &d| (a.min(d), b.max(d)));
    let mut out = format!("P6 {} {h} 255\n", 3 * w).into_bytes();
    let mut put = |rgb: [f32; 3]| out.extend(rgb.map(|v| (v.clamp(0.0, 1.0) * 255.0 + 0.5) as u8));
    for y in 0..h {
        for panel in 0..3 {
            for i in y * w..(y + 1) * w {
                put(match panel {
                    0 => frame.rgb[i],
                    1 => frame.normal[i].map(|v| 0.5 + 0.5 * v),
                    _ if frame.planar_depth[i].is_finite() => [(far - frame.planar_depth[i]) / (far - near); 3],
                    _ => [0.0; 3],
                });
            }
        }
    }
    std::fs::write(output, out)?;
    Ok(())
}
