//! Films are taken apart and decoded again, and compared with what went in.
#![allow(missing_docs)]

use std::path::Path;

use megas_film::Mp4Writer;
use megas_model::Image;
use openh264::{decoder::Decoder, formats::YUVSource};
use tempfile::tempdir;

/// A disc with texture that moves over a gradient.
fn frame(w: u32, h: u32, t: f32) -> Image {
    let mut image = Image::new(w, h, 3);
    for j in 0..h {
        for i in 0..w {
            let (x, y) = (i as f32 / h as f32, j as f32 / h as f32);
            let (dx, dy) = (x - 0.6 - 0.3 * t.cos(), y - 0.5 - 0.2 * t.sin());
            let inside = ((0.22 - dx.hypot(dy)) * 150.0).clamp(0.0, 1.0);
            let texture = 0.5 + 0.3 * (40.0 * dx).sin() * (35.0 * dy).cos();
            let back = [0.2 + 0.3 * y, 0.25 + 0.3 * y, 0.35 + 0.3 * x];
            let disc = [0.9 * texture + 0.2, 0.5 * texture, 0.3 * texture];
            let p = image.pixel_mut(i, j);
            (0..3).for_each(|c| p[c] = back[c] * (1.0 - inside) + disc[c] * inside);
        }
    }
    image
}

fn u32_at(bytes: &[u8], at: usize) -> u32 {
    u32::from_be_bytes(bytes[at..at + 4].try_into().unwrap())
}

/// Boxes directly inside `bytes`: name, content, offset of the content.
fn boxes(bytes: &[u8]) -> Vec<(String, &[u8], usize)> {
    let mut found = Vec::new();
    let mut at = 0;
    while at < bytes.len() {
        let size = u32_at(bytes, at) as usize;
        assert!(size >= 8 && at + size <= bytes.len(), "box at {at} has size {size}");
        found.push((String::from_utf8_lossy(&bytes[at + 4..at + 8]).into_owned(), &bytes[at + 8..at + size], at + 8));
        at += size;
    }
    found
}

fn find<'a>(mut bytes: &'a [u8], path: &str) -> &'a [u8] {
    for name in path.split('/') {
        bytes = boxes(bytes).into_iter().find(|b| b.0 == name).unwrap_or_else(|| panic!("no {name} of {path}")).1;
    }
    bytes
}

/// The samples of the only track as byte streams with start codes, parameter sets first.
fn samples(file: &[u8]) -> Vec<Vec<u8>> {
    let table = find(file, "moov/trak/mdia/minf/stbl");
    let stsz = find(table, "stsz");
    let n = u32_at(stsz, 8) as usize;
    let mut at = u32_at(find(table, "stco"), 8) as usize;
    let avc1 = &find(table, "stsd")[16..];
    let avcc = find(&avc1[78..], "avcC");
    let mut head = Vec::new();
    let mut k = 6;
    for _ in 0..2 {
        let length = u16::from_be_bytes([avcc[k], avcc[k + 1]]) as usize;
        head.extend([0, 0, 0, 1]);
        head.extend(&avcc[k + 2..k + 2 + length]);
        k += 2 + length + 1;
    }
    (0..n)
        .map(|i| {
            let size = u32_at(stsz, 12 + 4 * i) as usize;
            let mut out = if i == 0 { head.clone() } else { Vec::new() };
            let mut unit = &file[at..at + size];
            at += size;
            while !unit.is_empty() {
                let length = u32_at(unit, 0) as usize;
                out.extend([0, 0, 0, 1]);
                out.extend(&unit[4..4 + length]);
                unit = &unit[4 + length..];
            }
            out
        })
        .collect()
}

/// Display-referred RGB of a decoded picture (BT.709, limited range).
fn rgb(picture: &impl YUVSource, width: usize, height: usize) -> Vec<f32> {
    let (sy, su, sv) = picture.strides();
    let mut out = Vec::new();
    for j in 0..height {
        for i in 0..width {
            let y = (f32::from(picture.y()[j * sy + i]) - 16.0) / 219.0;
            let u = (f32::from(picture.u()[j / 2 * su + i / 2]) - 128.0) / 224.0;
            let v = (f32::from(picture.v()[j / 2 * sv + i / 2]) - 128.0) / 224.0;
            let (r, b) = (y + 1.5748 * v, y + 1.8556 * u);
            out.extend([r, (y - 0.2126 * r - 0.0722 * b) / 0.7152, b]);
        }
    }
    out
}

fn psnr(a: &[f32], b: &[f32]) -> f64 {
    let mse = a.iter().zip(b).map(|(a, b)| f64::from((a - b) * (a - b))).sum::<f64>() / a.len() as f64;
    -10.0 * mse.log10()
}

fn film(path: &Path, w: u32, h: u32, fps: f64, n: usize) -> Vec<Image> {
    let frames: Vec<_> = (0..n).map(|k| frame(w, h, k as f32 * 0.1)).collect();
    let mut writer = Mp4Writer::create(path, w, h, fps, false).unwrap();
    frames.iter().for_each(|f| writer.push(f).unwrap());
    let stats = writer.finish().unwrap();
    assert_eq!((stats.frames, stats.seconds), (n as u64, n as f64 / fps));
    frames
}

#[test]
fn decoded_frames_are_those_that_went_in() {
    let dir = tempdir().unwrap();
    for (name, w, h) in [("even.mp4", 320, 240), ("odd.mp4", 181, 133)] {
        let path = dir.path().join(name);
        let frames = film(&path, w, h, 24.0, 30);
        let file = std::fs::read(&path).unwrap();
        let mut decoder = Decoder::new().unwrap();
        let mut shown = 0;
        for (k, sample) in samples(&file).iter().enumerate() {
            let picture = decoder.decode(sample).unwrap().expect("one picture for each sample");
            assert_eq!(picture.dimensions(), (w.next_multiple_of(2) as usize, h.next_multiple_of(2) as usize));
            let p = psnr(&rgb(&picture, w as usize, h as usize), &frames[k].data);
            assert!(p > 35.0, "{name} frame {k}: {p} dB");
            // Frames in the wrong order would be far off.
            assert!(p > psnr(&rgb(&picture, w as usize, h as usize), &frames[(k + 3) % 30].data) + 6.0);
            shown += 1;
        }
        assert_eq!(shown, 30);
    }
}

#[test]
fn a_picture_too_rich_for_the_encoder_gets_coarser_instead_of_failing() {
    let dir = tempdir().unwrap();
    let path = dir.path().join("noise.mp4");
    let (w, h) = (1000, 800);
    let mut x = 1u32;
    let frames: Vec<Image> = (0..4)
        .map(|k| {
            let mut image = Image::new(w, h, 3);
            if k == 2 {
                image.data.iter_mut().for_each(|v| {
                    x = x.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                    *v = (x >> 8) as f32 / (1 << 24) as f32;
                });
            }
            image
        })
        .collect();
    let mut writer = Mp4Writer::create(&path, w, h, 30.0, false).unwrap();
    frames.iter().for_each(|f| writer.push(f).unwrap());
    writer.finish().unwrap();
    let file = std::fs::read(&path).unwrap();
    let stss = find(&file, "moov/trak/mdia/minf/stbl/stss");
    assert_eq!((u32_at(stss, 4), u32_at(stss, 12)), (2, 3), "the noise did not need the second attempt it is here for");
    let mut decoder = Decoder::new().unwrap();
    for (k, sample) in samples(&file).iter().enumerate() {
        let picture = decoder.decode(sample).unwrap().expect("a picture");
        // Of the noise only the luma can survive the halved chroma.
        let p = psnr(&rgb(&picture, w as usize, h as usize), &frames[k].data);
        assert!(p > if k == 2 { 10.0 } else { 35.0 }, "frame {k}: {p} dB");
    }
}

#[test]
fn the_index_comes_first_and_is_right() {
    let dir = tempdir().unwrap();
    let path = dir.path().join("a.mp4");
    film(&path, 64, 48, 25.0, 120);
    let file = std::fs::read(&path).unwrap();
    let order: Vec<_> = boxes(&file).into_iter().map(|b| b.0).collect();
    assert_eq!(order, ["ftyp", "moov", "mdat"]);
    let mdat = boxes(&file).into_iter().find(|b| b.0 == "mdat").unwrap();
    let table = find(&file, "moov/trak/mdia/minf/stbl");
    let (stsz, stco) = (find(table, "stsz"), find(table, "stco"));
    let sizes: u64 = (0..120).map(|i| u64::from(u32_at(stsz, 12 + 4 * i))).sum();
    assert_eq!((u32_at(stsz, 8), u32_at(stco, 8) as usize, sizes), (120, mdat.2, mdat.1.len() as u64));
    // 120 frames of 90000/25 ticks each, the last one included.
    let stts = find(table, "stts");
    let ticks: u64 = (0..u32_at(stts, 4) as usize).map(|i| u64::from(u32_at(stts, 8 + 8 * i)) * u64::from(u32_at(stts, 12 + 8 * i))).sum();
    let mdhd = find(&file, "moov/trak/mdia/mdhd");
    assert_eq!((ticks, u32_at(mdhd, 12), u32_at(mdhd, 16)), (432_000, 90_000, 432_000));
    let stss = find(table, "stss");
    let keys: Vec<u32> = (0..u32_at(stss, 4) as usize).map(|i| u32_at(stss, 8 + 4 * i)).collect();
    assert_eq!(keys, [1, 51, 101]);
}

#[test]
fn the_same_frames_give_the_same_file() {
    let dir = tempdir().unwrap();
    let (a, b) = (dir.path().join("a.mp4"), dir.path().join("b.mp4"));
    film(&a, 160, 120, 30.0, 10);
    film(&b, 160, 120, 30.0, 10);
    assert_eq!(std::fs::read(a).unwrap(), std::fs::read(b).unwrap());
}

#[test]
fn nothing_appears_before_the_end_and_mistakes_are_told() {
    let dir = tempdir().unwrap();
    let path = dir.path().join("a.mp4");
    let mut writer = Mp4Writer::create(&path, 64, 48, 30.0, false).unwrap();
    writer.push(&frame(64, 48, 0.0)).unwrap();
    assert!(!path.exists());
    let e = writer.push(&frame(64, 50, 0.0)).unwrap_err().to_string();
    assert!(e.contains("64x50") && e.contains("64x48"), "{e}");
    drop(writer);
    assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 0);
    assert!(Mp4Writer::create(&path, 64, 48, 30.0, false).unwrap().finish().is_err());
    for (w, h, fps) in [(8, 8, 30.0), (5000, 100, 30.0), (64, 48, 0.0), (64, 48, f64::NAN)] {
        assert!(Mp4Writer::create(&path, w, h, fps, false).is_err());
    }
    std::fs::write(&path, "mine").unwrap();
    assert!(Mp4Writer::create(&path, 64, 48, 30.0, false).is_err());
    assert_eq!(std::fs::read(&path).unwrap(), b"mine");
}
