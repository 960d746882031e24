//! Triangle meshes as Wavefront OBJ, with colours behind the positions (`v x y z r g b`) as most programs read them.

use std::{
    io::{BufRead, Write},
    path::Path,
};

use megas_model::Mesh;

use crate::{
    atomic::write_atomic,
    error::{FormatError, Place, Result, quoted},
    source::{self, Source},
};

/// Bytes a line may have.
const MAX_LINE: usize = 1 << 20;

/// Reads the vertices and faces of an OBJ file; groups, materials, textures, lines and curves are passed over. Polygons
/// become fans of triangles. Normals are kept where every corner names the normal with its vertex' own number; colours
/// where every vertex has them.
pub fn read_mesh_obj(path: impl AsRef<Path>) -> Result<Mesh> {
    read(&mut source::open(path.as_ref())?)
}

/// What is told to the reader of an error.
const REMEDY: &str = "repair or export the mesh again";

pub(crate) fn read<R: BufRead>(source: &mut Source<'_, R>) -> Result<Mesh> {
    let path = source.path;
    let mut mesh = Mesh::default();
    let mut normals: Vec<[f32; 3]> = Vec::new();
    // Whether every corner so far names the normal with its vertex' number.
    let mut own_normals = true;
    let (mut line, mut text) = (Vec::new(), String::new());
    let mut corners: Vec<u32> = Vec::new();
    while source.line_into(&mut line, MAX_LINE)? {
        let number = source.line();
        let piece = String::from_utf8_lossy(&line);
        // A backslash at the end continues the line.
        if let Some(head) = piece.strip_suffix('\\') {
            if text.len() + head.len() > MAX_LINE {
                let found = format!("more than {MAX_LINE} bytes over several lines");
                return Err(FormatError::defect(path, Place::Line(number), found, "the end of the line", REMEDY));
            }
            text.push_str(head);
            text.push(' ');
            continue;
        }
        text.push_str(&piece);
        let bad = |found: &str, expected: &str| Err(FormatError::defect(path, Place::Line(number), quoted(found), expected, REMEDY));
        let body = text.split('#').next().unwrap_or_default();
        let mut words = body.split_ascii_whitespace();
        match words.next() {
            Some("v") => {
                let mut values = [0.0f32; 7];
                let mut n = 0;
                for w in words {
                    match w.parse::<f32>() {
                        Ok(v) if v.is_finite() && n < 7 => values[n] = v,
                        _ => return bad(w, "a position of three finite numbers, a colour of three behind it"),
                    }
                    n += 1;
                }
                if n < 3 {
                    return bad(body.trim(), "three coordinates");
                }
                if mesh.positions.len() >= u32::MAX as usize {
                    return bad(body.trim(), "fewer than 2^32 vertices");
                }
                mesh.positions.push([values[0], values[1], values[2]]);
                match n {
                    6 => mesh.colours.push([values[3], values[4], values[5]]),
                    7 => mesh.colours.push([values[4], values[5], values[6]]),
                    _ => {}
                }
            }
            Some("vn") => {
                let mut v = [0.0f32; 3];
                for out in &mut v {
                    let Some(Ok(x)) = words.next().map(str::parse::<f32>) else { return bad(body.trim(), "'vn X Y Z'") };
                    *out = x;
                }
                normals.push(v);
            }
            Some("f") => {
                corners.clear();
                for w in words {
                    let mut parts = w.split('/');
                    let vertex = parts.next().and_then(|p| index(p, mesh.positions.len()));
                    let Some(vertex) = vertex else {
                        let expected = format!("a vertex from 1 to {} (or negative, from the end)", mesh.positions.len());
                        return bad(w, &expected);
                    };
                    let normal = parts.nth(1).and_then(|p| index(p, normals.len()));
                    own_normals &= normal == Some(vertex);
                    corners.push(vertex);
                }
                if corners.len() < 3 {
                    return bad(body.trim(), "three or more corners");
                }
                let first = corners[0];
                mesh.triangles.extend(corners[1..].windows(2).map(|w| [first, w[0], w[1]]));
            }
            _ => {}
        }
        text.clear();
    }
    if mesh.positions.is_empty() {
        let remedy = "this is not a triangle mesh, or it is damaged";
        return Err(FormatError::defect(path, Place::File, "no vertices", "lines 'v X Y Z'", remedy));
    }
    if mesh.colours.len() != mesh.positions.len() {
        mesh.colours.clear();
    }
    if own_normals && normals.len() == mesh.positions.len() && !mesh.triangles.is_empty() {
        mesh.normals = normals;
    }
    Ok(mesh)
}

/// A number of an OBJ file, from 1 or negative from the end, as an index below `count`.
fn index(word: &str, count: usize) -> Option<u32> {
    let k: i64 = word.parse().ok()?;
    let i = if k > 0 { k - 1 } else { count as i64 + k };
    (k != 0 && (0..count as i64).contains(&i)).then_some(i as u32)
}

/// Writes a mesh with colours and normals where it has them, atomically. OBJ knows no temperature.
pub fn write_mesh_obj(path: impl AsRef<Path>, mesh: &Mesh, overwrite: bool) -> Result<()> {
    let n = mesh.positions.len();
    let (colours, normals) = (mesh.colours.len() == n, mesh.normals.len() == n && n > 0);
    write_atomic(path, overwrite, |w| {
        for (i, p) in mesh.positions.iter().enumerate() {
            write!(w, "v {} {} {}", p[0], p[1], p[2])?;
            if colours {
                let c = mesh.colours[i].map(|c| c.clamp(0.0, 1.0));
                write!(w, " {:.4} {:.4} {:.4}", c[0], c[1], c[2])?;
            }
            writeln!(w)?;
        }
        if normals {
            mesh.normals.iter().try_for_each(|v| writeln!(w, "vn {} {} {}", v[0], v[1], v[2]))?;
        }
        for t in &mesh.triangles {
            let [a, b, c] = t.map(|i| u64::from(i) + 1);
            if normals { writeln!(w, "f {a}//{a} {b}//{b} {c}//{c}")? } else { writeln!(w, "f {a} {b} {c}")? }
        }
        Ok(())
    })
}
