//! `cameras.txt`, `images.txt`, `points3D.txt`: the twins of the binary files (splatting.md §2.1).

use std::{io::BufRead, path::Path, str::FromStr};

use super::{Model, RawCamera, RawImage, RawPoint};
use crate::{
    error::{CaptureError, Fault, Result, quoted},
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

/// The words of one line, with its place for messages.
struct Words<'l, R> {
    source: &'l Source<R>,
    rest: &'l str,
}

impl<'l, R: BufRead> Words<'l, R> {
    fn word(&mut self) -> &'l str {
        let text = self.rest.trim_start();
        let (word, rest) = text.split_at(text.find(char::is_whitespace).unwrap_or(text.len()));
        self.rest = rest;
        word
    }

    fn number<T: FromStr>(&mut self, what: &str) -> Result<T> {
        let word = self.word();
        word.parse().map_err(|_| {
            let found = if word.is_empty() { "the end of the line".into() } else { quoted(word) };
            self.fault(Fault::new(found, what, "correct the line or export the model again as text"))
        })
    }

    fn numbers<const N: usize>(&mut self, what: &str) -> Result<[f64; N]> {
        let mut values = [0.0; N];
        for v in &mut values {
            *v = self.number(what)?;
        }
        Ok(values)
    }

    fn fault(&self, fault: Fault) -> CaptureError {
        fault.at(self.source.path(), self.source.place())
    }
}

/// The next line that is neither empty nor a comment.
fn content<R: BufRead>(s: &mut Source<R>, line: &mut String) -> Result<bool> {
    while s.line_into(line)? {
        let text = line.trim();
        if !text.is_empty() && !text.starts_with('#') {
            return Ok(true);
        }
    }
    Ok(false)
}

fn read_cameras<R: BufRead>(s: &mut Source<R>) -> Result<Vec<(i64, RawCamera)>> {
    let mut line = String::new();
    let mut cameras = Vec::new();
    while content(s, &mut line)? {
        let mut words = Words { source: s, rest: &line };
        let id: i64 = words.number("the number of a camera")?;
        let model = Model::by_name(words.word()).map_err(|f| words.fault(f))?;
        let size = [words.number("the width in pixels")?, words.number("the height in pixels")?];
        let parameters = (0..model.parameters()).map(|_| words.number("a camera parameter")).collect::<Result<_>>()?;
        if !words.word().is_empty() {
            let expected = format!("{} parameters", model.parameters());
            return Err(words.fault(Fault::new("more values", expected, "correct the line or export the model again as text")));
        }
        cameras.push((id, RawCamera { model, size, parameters }));
    }
    Ok(cameras)
}

fn read_images<R: BufRead>(s: &mut Source<R>) -> Result<Vec<RawImage>> {
    let mut line = String::new();
    let mut images = Vec::new();
    while content(s, &mut line)? {
        let mut words = Words { source: s, rest: &line };
        let id: i64 = words.number("the number of an image")?;
        let quaternion = words.numbers("a number of the rotation")?;
        let translation = words.numbers("a number of the translation")?;
        let camera = words.number("the number of a camera")?;
        // Names may hold spaces: the name is the rest of the line.
        let name = words.rest.trim().to_owned();
        if name.is_empty() {
            return Err(words.fault(Fault::new("the end of the line", "the name of the image", "export the model again as text")));
        }
        images.push(RawImage { place: format!("image {id} {}", quoted(&name)), name, quaternion, translation, camera });
        // The 2-D points, three numbers each; the line may be empty, and at the very end it may be missing. A file without
        // these lines would lose every second image in silence.
        s.line_into(&mut line)?;
        if !line.split_whitespace().count().is_multiple_of(3) {
            let remedy = "write a (possibly empty) line of 2-D points after every image, as COLMAP does";
            let fault = Fault::new(quoted(&line), "a line of 2-D points: x, y and point number in turn", remedy);
            return Err(fault.at(s.path(), s.place()));
        }
    }
    Ok(images)
}

fn read_points<R: BufRead>(s: &mut Source<R>) -> Result<Vec<RawPoint>> {
    let mut line = String::new();
    let mut points = Vec::new();
    while content(s, &mut line)? {
        let mut words = Words { source: s, rest: &line };
        let _id: u64 = words.number("the number of a point")?;
        let position = words.numbers("a coordinate")?;
        let mut colour = [0u8; 3];
        for c in &mut colour {
            *c = words.number("a colour from 0 to 255")?;
        }
        let error = words.number("the error of the point")?;
        points.push(RawPoint { position, colour, error });
    }
    Ok(points)
}

#[cfg(test)]
mod tests {
    use std::io::Cursor;

    use proptest::prelude::*;

    use super::*;

    fn source(text: &str) -> Source<Cursor<&[u8]>> {
        Source::new(Path::new("x.txt"), Cursor::new(text.as_bytes()), text.len() as u64)
    }

    const IMAGES: &str =
        "# comment\n1 1 0 0 0 0.1 0.2 0.3 1 a b.jpg\n10.5 20 -1 3 4 17\n2 1 0 0 0 0 0 1 1 c.jpg\n\n3 1 0 0 0 0 0 1 1 d.jpg";

    #[test]
    fn names_may_hold_spaces_and_point_lines_may_be_empty() {
        let images = read_images(&mut source(IMAGES)).unwrap();
        let names: Vec<&str> = images.iter().map(|i| &*i.name).collect();
        assert_eq!(names, ["a b.jpg", "c.jpg", "d.jpg"]);
        assert_eq!(images[0].translation, [0.1, 0.2, 0.3]);
    }

    #[test]
    fn a_file_without_point_lines_is_refused() {
        let text = "1 1 0 0 0 0.1 0.2 0.3 1 a.jpg\n2 1 0 0 0 0 0 1 1 c.jpg\n";
        let message = read_images(&mut source(text)).err().unwrap().to_string();
        assert!(message.contains("line 2") && message.contains("2-D points"), "{message}");
    }

    #[test]
    fn errors_name_the_line() {
        for (text, what) in [
            ("1 PINHOLE 640 480 500 500 320\n", "end of the line"),
            ("\n#\n1 PINHOLE 640 480 500 500 320 240 9\n", "line 3"),
            ("1 FULL_OPENCV 640 480 500 500 320 240\n", "'FULL_OPENCV'"),
            ("1 PINHOLE -640 480 500 500 320 240\n", "'-640'"),
        ] {
            let message = read_cameras(&mut source(text)).err().unwrap().to_string();
            assert!(message.contains(what), "{message}");
        }
        let message = read_points(&mut source("1 0 0 0 300 0 0 1\n")).err().unwrap().to_string();
        assert!(message.contains("'300'"), "{message}");
    }

    proptest! {
        #[test]
        fn mutated_text_never_panics(edits in prop::collection::vec((0usize..200, any::<char>()), 1..10)) {
            let mut chars: Vec<char> = IMAGES.chars().collect();
            let n = chars.len();
            edits.iter().for_each(|(i, c)| chars[i % n] = *c);
            let text: String = chars.into_iter().collect();
            drop(read_images(&mut source(&text)));
            drop(read_cameras(&mut source(&text)));
            drop(read_points(&mut source(&text)));
        }
    }
}
