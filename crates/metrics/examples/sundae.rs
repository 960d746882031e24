//! Photographs the embedded scene: `cargo run -p megas-metrics --example sundae -- OUT.png [azimuth°] [elevation°] [width]`.

use megas_metrics::assets::{Sundae, photograph};
use megas_model::{Camera, Image};

/// The picture over a soft grey gradient.
fn composite(image: &Image) -> Vec<u8> {
    let mut out = Vec::with_capacity((image.width * image.height * 3) as usize);
    for y in 0..image.height {
        for x in 0..image.width {
            let p = image.pixel(x, y);
            let (u, v) = (x as f32 / image.width as f32 - 0.5, y as f32 / image.height as f32 - 0.55);
            let g = 0.93 - 0.35 * (u * u + v * v);
            let background = [g, g, g * 1.01];
            for c in 0..3 {
                let v = p[c] * p[3] + background[c] * (1.0 - p[3]);
                out.push((v.clamp(0.0, 1.0) * 255.0 + 0.5) as u8);
            }
        }
    }
    out
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let args: Vec<String> = std::env::args().collect();
    let get = |i: usize, d: f32| args.get(i).and_then(|s| s.parse().ok()).unwrap_or(d);
    let path = args.get(1).map_or("sundae.png", String::as_str);
    let (az, el, width) = (get(2, 0.0).to_radians(), get(3, 18.0).to_radians(), get(4, 640.0) as u32);
    let clock = std::time::Instant::now();
    let scene = Sundae::new();
    println!("built in {:.2} s", clock.elapsed().as_secs_f32());
    let target = [0.0, 0.0, 0.58];
    let eye = [4.6 * az.sin() * el.cos(), -4.6 * az.cos() * el.cos(), target[2] + 4.6 * el.sin()];
    let camera = Camera::look_at(eye, target, [0.0, 0.0, 1.0], 33f32.to_radians(), width, width * 3 / 4);
    let clock = std::time::Instant::now();
    let view = photograph(&scene, &camera, 2, "sundae");
    println!("photographed in {:.2} s", clock.elapsed().as_secs_f32());
    image::save_buffer(path, &composite(&view.image), width, width * 3 / 4, image::ColorType::Rgb8)?;
    Ok(())
}
