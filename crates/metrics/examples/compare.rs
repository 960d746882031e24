//! Photograph, rendered splats and their difference side by side:
//! `cargo run -p megas-metrics --example compare -- OUT.png [azimuth°] [elevation°] [width] [spacing] [size] [table spacing]`.

use std::time::Instant;

use megas_math::vec3;
use megas_metrics::assets::{Part, Sprinkle, Sundae, photograph};
use megas_model::Camera;
use megas_raster::{Channels, Gaussians, Rasterizer, Settings};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let args: Vec<String> = std::env::args().collect();
    let get = |i: usize, d: f32| args.get(i).and_then(|s| s.parse().ok()).unwrap_or(d);
    let path = args.get(1).map_or("compare.png", String::as_str);
    let (az, el, w) = (get(2, 0.0).to_radians(), get(3, 18.0).to_radians(), get(4, 640.0) as u32);
    let h = w * 3 / 4;
    let d = Sprinkle::default();
    let settings = Sprinkle { spacing: get(5, d.spacing), size: get(6, d.size), table_spacing: get(7, d.table_spacing), ..d };
    let scene = Sundae::new();
    let clock = Instant::now();
    let splats = scene.sprinkle(&settings);
    let object = splats.object_id.iter().filter(|&&o| o > 0).count();
    println!("{} splats, {object} on the object, in {:.2} s", splats.len(), clock.elapsed().as_secs_f32());
    let target = [0.0, 0.0, 0.58];
    let eye = [4.6 * az.sin() * el.cos(), -4.6 * az.cos() * el.cos(), target[2] + 4.6 * el.sin()];
    let camera = Camera::look_at(eye, target, [0.0, 0.0, 1.0], 33f32.to_radians(), w, h);
    let view = photograph(&scene, &camera, 2, "");
    let background = [0.88; 3];
    let frame =
        Rasterizer::new().frame(&Gaussians::from_splats(&splats), &camera, &Settings { background, ..Settings::default() }, Channels::Rgba);
    let (mut error, mut inside, mut inside_count, mut leak) = (0.0f64, 0.0f64, 0usize, 0.0f64);
    let mut parts = [(0.0f64, 0usize); 8];
    let mut out = vec![0u8; (w * h * 9) as usize];
    for y in 0..h {
        for x in 0..w {
            let p = view.image.pixel(x, y);
            let r = frame.rgb[(y * w + x) as usize];
            for c in 0..3 {
                let photo = p[c] * p[3] + background[c] * (1.0 - p[3]);
                let e = f64::from(photo - r[c].clamp(0.0, 1.0)).powi(2);
                error += e;
                if p[3] == 1.0 {
                    inside += e;
                    inside_count += 1;
                    if let Some(depth) = view.depth.as_ref().map(|d| d.pixel(x, y)[0]).filter(|d| d.is_finite()) {
                        let (o, d) = camera.ray(x as f32 + 0.5, y as f32 + 0.5);
                        let t = depth / vec3::dot(d, camera.rotation[2]);
                        let part = &mut parts[scene.part(vec3::add_scaled(o, d, t)) as usize];
                        *part = (part.0 + e, part.1 + 1);
                    }
                }
                out[((y * 3 * w + x) * 3) as usize + c] = (photo.clamp(0.0, 1.0) * 255.0 + 0.5) as u8;
                out[((y * 3 * w + w + x) * 3) as usize + c] = (r[c].clamp(0.0, 1.0) * 255.0 + 0.5) as u8;
                out[((y * 3 * w + 2 * w + x) * 3) as usize + c] = ((0.5 + 2.0 * (r[c] - photo)).clamp(0.0, 1.0) * 255.0 + 0.5) as u8;
            }
            if p[3] == 1.0 {
                leak += f64::from(frame.transmittance[(y * w + x) as usize]);
            }
        }
    }
    let psnr = |e: f64, n: usize| -10.0 * (e / n as f64).log10();
    println!(
        "PSNR {:.2} dB, inside {:.2} dB, mean transmittance inside {:.4}",
        psnr(error, (w * h * 3) as usize),
        psnr(inside, inside_count),
        leak / (inside_count / 3) as f64
    );
    for (part, (e, n)) in Part::ALL.iter().zip(parts) {
        println!("  {:>10}: {:.2} dB, {} pixels", part.name(), psnr(e, n), n / 3);
    }
    image::save_buffer(path, &out, 3 * w, h, image::ColorType::Rgb8)?;
    Ok(())
}
