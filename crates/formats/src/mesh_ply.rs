//! Triangle meshes as PLY.

use std::{
    io::{BufRead, Write},
    path::Path,
};

use megas_model::Mesh;

use crate::{
    atomic::write_atomic,
    error::{FormatError, Place, Result},
    gather::row_count,
    ply::{Column, Element, Header, Kind, Row, for_each_block, next_row, skip},
    source::{self, Source},
};

/// Reads a mesh; faces with more than three corners become fans of triangles.
pub fn read_mesh_ply(path: impl AsRef<Path>) -> Result<Mesh> {
    read(&mut source::open(path.as_ref())?)
}

pub(crate) fn read<R: BufRead>(source: &mut Source<'_, R>) -> Result<Mesh> {
    let header = Header::read(source)?;
    let mut mesh = Mesh::default();
    for element in &header.elements {
        match element.name.as_str() {
            "vertex" => vertices(source, &header, element, &mut mesh)?,
            "face" => faces(source, &header, element, &mut mesh)?,
            _ => skip(source, element, header.encoding)?,
        }
    }
    let bad = |element: &str, found: String, expected: &str| {
        let remedy = "this is not a triangle mesh, or it is damaged";
        Err(FormatError::defect(source.path, Place::Element(element.into()), found, expected, remedy))
    };
    if mesh.positions.is_empty() {
        return bad("vertex", "no vertices".into(), "at least one");
    }
    let n = mesh.positions.len();
    match mesh.triangles.iter().flatten().find(|i| **i as usize >= n) {
        Some(i) => bad("face", format!("vertex index {i}"), &format!("less than {n}")),
        None => Ok(mesh),
    }
}

fn vertices<R: BufRead>(source: &mut Source<'_, R>, header: &Header, element: &Element, mesh: &mut Mesh) -> Result<()> {
    let path = source.path;
    let remedy = "this is not a triangle mesh";
    let triple = |names: [&str; 3]| -> Option<[Column; 3]> {
        let [a, b, c] = names.map(|n| element.column(n));
        Some([a?, b?, c?])
    };
    let position = [element.need(path, "x", remedy)?, element.need(path, "y", remedy)?, element.need(path, "z", remedy)?];
    let normal = triple(["nx", "ny", "nz"]);
    let colour = triple(["red", "green", "blue"]);
    let temperature = element.column("temperature");
    element.check_fits(path, header.encoding, source.remaining(), 0)?;
    mesh.positions.reserve_exact(row_count(path, "vertex", element.count)?);
    let stride = element.stride().unwrap_or(1).max(1);
    for_each_block(source, element, header.encoding, |block| {
        for row in block.chunks_exact(stride) {
            let p = position.map(|c| c.f32(row));
            if p.iter().any(|v| !v.is_finite()) {
                let place = Place::Row { element: "vertex".into(), row: mesh.positions.len() as u64 };
                return Err(FormatError::defect(path, place, format!("{p:?}"), "a finite position", "repair or export the mesh again"));
            }
            mesh.positions.push(p);
            mesh.normals.extend(normal.map(|c| c.map(|c| c.f32(row))));
            mesh.colours.extend(colour.map(|c| c.map(|c| c.f32(row) / if c.scalar.is_integer() { 255.0 } else { 1.0 })));
            mesh.temperature.extend(temperature.map(|c| c.f32(row)));
        }
        Ok(())
    })
}

fn faces<R: BufRead>(source: &mut Source<'_, R>, header: &Header, element: &Element, mesh: &mut Mesh) -> Result<()> {
    let path = source.path;
    let list = element.properties.iter().enumerate().find_map(|(k, p)| match p.kind {
        Kind::List { item, .. } if matches!(p.name.as_str(), "vertex_indices" | "vertex_index") => Some((k, item)),
        _ => None,
    });
    let Some((k, item)) = list else {
        let place = Place::Property { element: "face".into(), property: "vertex_indices".into() };
        return Err(FormatError::defect(path, place, "nothing", "a list of vertex numbers", "this is not a triangle mesh"));
    };
    // Three corners at least: what the file can hold bounds what is reserved.
    element.check_fits(path, header.encoding, source.remaining(), 3)?;
    mesh.triangles.reserve(element.count as usize);
    let mut row = Row::default();
    let mut corners = Vec::new();
    for index in 0..element.count {
        next_row(source, element, header.encoding, index, &mut row)?;
        corners.clear();
        corners.extend(row.values(k, item));
        let good = |v: &f64| *v >= 0.0 && *v < f64::from(u32::MAX) && v.fract() == 0.0;
        if corners.len() < 3 || !corners.iter().all(good) {
            let place = Place::Row { element: "face".into(), row: index };
            let found = format!("{:?}", &corners[..corners.len().min(4)]);
            return Err(FormatError::defect(path, place, found, "three or more vertex numbers", "repair or export the mesh again"));
        }
        let first = corners[0] as u32;
        mesh.triangles.extend(corners[1..].windows(2).map(|w| [first, w[0] as u32, w[1] as u32]));
    }
    Ok(())
}

/// Writes a mesh as binary little-endian PLY with whatever attributes it has (colours with 8 bits), atomically.
pub fn write_mesh_ply(path: impl AsRef<Path>, mesh: &Mesh, overwrite: bool) -> Result<()> {
    let n = mesh.positions.len();
    let has = |len: usize| len == n && n > 0;
    let (normals, colours) = (has(mesh.normals.len()), has(mesh.colours.len()));
    let temperature = has(mesh.temperature.len());
    let mut header = format!("ply\nformat binary_little_endian 1.0\nelement vertex {n}\n");
    let properties = [
        (true, "float", &["x", "y", "z"][..]),
        (normals, "float", &["nx", "ny", "nz"]),
        (colours, "uchar", &["red", "green", "blue"]),
        (temperature, "float", &["temperature"]),
    ];
    for (_, kind, names) in properties.iter().filter(|p| p.0) {
        names.iter().for_each(|name| header.push_str(&format!("property {kind} {name}\n")));
    }
    header.push_str(&format!("element face {}\nproperty list uchar uint vertex_indices\nend_header\n", mesh.triangles.len()));
    write_atomic(path, overwrite, |w| {
        w.write_all(header.as_bytes())?;
        let mut row = Vec::new();
        for i in 0..n {
            row.clear();
            let mut put = |v: &[f32]| v.iter().for_each(|v| row.extend_from_slice(&v.to_le_bytes()));
            put(&mesh.positions[i]);
            if normals {
                put(&mesh.normals[i]);
            }
            if colours {
                row.extend(mesh.colours[i].map(|c| (c.clamp(0.0, 1.0) * 255.0 + 0.5) as u8));
            }
            if temperature {
                row.extend_from_slice(&mesh.temperature[i].to_le_bytes());
            }
            w.write_all(&row)?;
        }
        for t in &mesh.triangles {
            w.write_all(&[3])?;
            t.iter().try_for_each(|i| w.write_all(&i.to_le_bytes()))?;
        }
        Ok(())
    })
}
