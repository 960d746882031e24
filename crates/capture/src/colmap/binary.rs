//! `cameras.bin`, `images.bin`, `points3D.bin`; little endian (splatting.md §2.1).

use std::{io::BufRead, path::Path};

use super::{Model, RawCamera, RawImage, RawPoint};
use crate::{
    error::{Fault, Result, TRUNCATED, quoted},
    path::MAX_NAME,
    source::{Source, open},
};

pub(super) fn cameras(path: &Path) -> Result<Vec<(i64, RawCamera)>> {
    read_cameras(&mut open(path)?)
}

pub(super) fn images(path: &Path) -> Result<Vec<RawImage>> {
    read_images(&mut open(path)?)
}

pub(super) fn points(path: &Path) -> Result<Vec<RawPoint>> {
    read_points(&mut open(path)?)
}

fn read_cameras<R: BufRead>(s: &mut Source<R>) -> Result<Vec<(i64, RawCamera)>> {
    // id, model, size and three parameters at least.
    let n = s.count(4 + 4 + 16 + 24, "cameras")?;
    let mut cameras = Vec::with_capacity(n as usize);
    for _ in 0..n {
        let id = s.i32()?;
        let model = s.i32()?;
        let model = Model::by_id(model).map_err(|f| f.at(s.path(), format!("camera {id}")))?;
        let size = [s.u64()?, s.u64()?];
        let parameters = (0..model.parameters()).map(|_| s.f64()).collect::<Result<_>>()?;
        cameras.push((i64::from(id), RawCamera { model, size, parameters }));
    }
    end(s)?;
    Ok(cameras)
}

fn read_images<R: BufRead>(s: &mut Source<R>) -> Result<Vec<RawImage>> {
    // id, pose, camera, an empty name and a count.
    let n = s.count(4 + 56 + 4 + 1 + 8, "images")?;
    let mut images = Vec::with_capacity(n as usize);
    for _ in 0..n {
        let id = s.i32()?;
        let (quaternion, translation) = (s.f64s::<4>()?, s.f64s::<3>()?);
        let camera = i64::from(s.i32()?);
        let name = String::from_utf8(s.nul_terminated(MAX_NAME)?).map_err(|e| {
            let found = format!("a name that is not UTF-8: {}", quoted(&String::from_utf8_lossy(e.as_bytes())));
            Fault::new(found, "a readable file name", "rename the image and run the pose estimation again")
                .at(s.path(), format!("image {id}"))
        })?;
        let observations = s.u64()?;
        s.skip(observations, 8 + 8 + 8)?;
        images.push(RawImage { place: format!("image {id} {}", quoted(&name)), name, quaternion, translation, camera });
    }
    end(s)?;
    Ok(images)
}

fn read_points<R: BufRead>(s: &mut Source<R>) -> Result<Vec<RawPoint>> {
    let n = s.count(8 + 24 + 3 + 8 + 8, "points")?;
    let mut points = Vec::with_capacity(n as usize);
    for _ in 0..n {
        let _id = s.u64()?;
        let position = s.f64s::<3>()?;
        let colour = s.array::<3>()?;
        let error = s.f64()?;
        let track = s.u64()?;
        s.skip(track, 4 + 4)?;
        points.push(RawPoint { position, colour, error });
    }
    end(s)?;
    Ok(points)
}

/// Bytes after the last row mean that rows were misread: better said than trained on.
fn end<R: BufRead>(s: &Source<R>) -> Result<()> {
    match s.remaining() {
        0 => Ok(()),
        n => Err(Fault::new(format!("{n} bytes after the last row"), "the end of the file", TRUNCATED).at(s.path(), s.place())),
    }
}

#[cfg(test)]
mod tests {
    use std::io::Cursor;

    use proptest::prelude::*;

    use super::*;

    fn source(bytes: &[u8]) -> Source<Cursor<&[u8]>> {
        Source::new(Path::new("x.bin"), Cursor::new(bytes), bytes.len() as u64)
    }

    fn camera_bytes() -> Vec<u8> {
        let mut b = 2u64.to_le_bytes().to_vec();
        for (id, model, n) in [(1i32, 1i32, 4), (7, 4, 8)] {
            b.extend(id.to_le_bytes());
            b.extend(model.to_le_bytes());
            b.extend(640u64.to_le_bytes());
            b.extend(480u64.to_le_bytes());
            (0..n).for_each(|i| b.extend(f64::from(100 + i).to_le_bytes()));
        }
        b
    }

    fn image_bytes() -> Vec<u8> {
        let mut b = 2u64.to_le_bytes().to_vec();
        for (id, name, n) in [(3i32, "a/b.jpg", 2u64), (4, "c.png", 0)] {
            b.extend(id.to_le_bytes());
            [1.0, 0.0, 0.0, 0.0, 0.1, 0.2, 0.3].iter().for_each(|v: &f64| b.extend(v.to_le_bytes()));
            b.extend(1i32.to_le_bytes());
            b.extend(name.as_bytes());
            b.push(0);
            b.extend(n.to_le_bytes());
            b.extend(vec![5; 24 * n as usize]);
        }
        b
    }

    fn point_bytes() -> Vec<u8> {
        let mut b = 3u64.to_le_bytes().to_vec();
        for id in 0..3u64 {
            b.extend(id.to_le_bytes());
            [1.0, 2.0, 3.0].iter().for_each(|v: &f64| b.extend(v.to_le_bytes()));
            b.extend([10, 20, 30]);
            b.extend(0.5f64.to_le_bytes());
            b.extend(id.to_le_bytes());
            b.extend(vec![1; 8 * id as usize]);
        }
        b
    }

    #[test]
    fn whole_files_read_and_every_truncation_is_named() {
        let c = read_cameras(&mut source(&camera_bytes())).unwrap();
        assert_eq!((c.len(), c[1].0, c[1].1.parameters.len()), (2, 7, 8));
        let i = read_images(&mut source(&image_bytes())).unwrap();
        assert_eq!((&*i[0].name, &*i[1].name, i[0].translation[2]), ("a/b.jpg", "c.png", 0.3));
        let p = read_points(&mut source(&point_bytes())).unwrap();
        assert_eq!((p.len(), p[2].colour), (3, [10, 20, 30]));
        for k in 0..camera_bytes().len() {
            assert!(read_cameras(&mut source(&camera_bytes()[..k])).is_err());
        }
        for k in 0..image_bytes().len() {
            let message = read_images(&mut source(&image_bytes()[..k])).err().map(|e| e.to_string()).unwrap_or_default();
            assert!(message.contains("truncated") && message.contains("byte "), "{k}: {message}");
        }
        for k in 0..point_bytes().len() {
            assert!(read_points(&mut source(&point_bytes()[..k])).is_err());
        }
    }

    #[test]
    fn absurd_counts_are_refused_before_anything_is_allocated() {
        for n in [u64::MAX, 1 << 60, 1 << 33, 4] {
            let mut b = point_bytes();
            b[..8].copy_from_slice(&n.to_le_bytes());
            let message = read_points(&mut source(&b)).err().map(|e| e.to_string()).unwrap_or_default();
            assert!(message.contains("claimed") || message.contains("more data"), "{message}");
        }
        let mut b = image_bytes();
        let at = b.len() - 8;
        b[at..].copy_from_slice(&u64::MAX.to_le_bytes());
        assert!(read_images(&mut source(&b)).is_err());
        let mut b = camera_bytes();
        b[12] = 9;
        assert!(read_cameras(&mut source(&b)).err().unwrap().to_string().contains("image_undistorter"));
    }

    proptest! {
        #[test]
        fn mutated_files_never_panic(seed in prop::collection::vec((0usize..400, any::<u8>()), 1..12), cut in 0usize..400) {
            for (which, mut b) in [camera_bytes(), image_bytes(), point_bytes()].into_iter().enumerate() {
                let n = b.len();
                seed.iter().for_each(|(i, v)| b[i % n] = *v);
                b.truncate(n - cut % n);
                let mut s = source(&b);
                match which {
                    0 => drop(read_cameras(&mut s)),
                    1 => drop(read_images(&mut s)),
                    _ => drop(read_points(&mut s)),
                }
            }
        }

        #[test]
        fn noise_never_panics(b in prop::collection::vec(any::<u8>(), 0..300)) {
            drop(read_cameras(&mut source(&b)));
            drop(read_images(&mut source(&b)));
            drop(read_points(&mut source(&b)));
        }
    }
}
