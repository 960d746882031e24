//! The PLY of the splat ecosystem (splatting.md §1.3): properties by name in any order and type, extras of this project.

use std::io::{self, BufRead, Write};

use megas_math::sh;
use megas_model::{AMBIENT_K, Splats};

use crate::{
    error::{FormatError, Place, Result},
    gather::{Gather, LOG_SCALE, degree_of_rest, row_count},
    ply::{Column, Element, Header, for_each_block, skip},
    source::Source,
    splat_file::{RenderMode, SplatFile, SplatFormat, WriteOptions},
};

/// `ln 0.01`: thickness that a 2D Gaussian gets, relative to its shorter axis.
const LN_FLAT: f32 = -4.605_170_2;

struct Columns {
    mean: [Column; 3],
    dc: [Column; 3],
    /// In the order of the set: `[coefficient][channel]`.
    rest: Vec<Column>,
    opacity: Column,
    scale: [Column; 2],
    scale_2: Option<Column>,
    rotation: [Column; 4],
    temperature: Option<Column>,
    object_id: Option<Column>,
    phase: Option<Column>,
    origin: Option<Column>,
    normal_sign: Option<Column>,
    birth_id: Option<Column>,
    trained_pixel: Option<Column>,
}

impl Columns {
    fn find(path: &std::path::Path, element: &Element) -> Result<Self> {
        const REMEDY: &str = "this looks like a point cloud or a mesh, give a Gaussian splat";
        let need = |name: &str| element.need(path, name, REMEDY);
        let prefixed = element.properties.iter().filter(|p| p.name.starts_with("f_rest_")).count();
        if degree_of_rest(prefixed).is_none() {
            let place = Place::Property { element: element.name.clone(), property: "f_rest_*".into() };
            let expected = "0, 9, 24 or 45 of them (spherical harmonics of degree 0 to 3)";
            let remedy = "export the file with a degree of at most 3";
            return Err(FormatError::defect(path, place, format!("{prefixed} properties"), expected, remedy));
        }
        let per_channel = prefixed / 3;
        let rest = (0..prefixed).map(|i| need(&format!("f_rest_{}", (i % 3) * per_channel + i / 3))).collect::<Result<_>>()?;
        Ok(Self {
            mean: [need("x")?, need("y")?, need("z")?],
            dc: [need("f_dc_0")?, need("f_dc_1")?, need("f_dc_2")?],
            rest,
            opacity: need("opacity")?,
            scale: [need("scale_0")?, need("scale_1")?],
            scale_2: element.column("scale_2"),
            rotation: [need("rot_0")?, need("rot_1")?, need("rot_2")?, need("rot_3")?],
            temperature: element.column("temperature"),
            object_id: element.column("object_id"),
            phase: element.column("phase"),
            origin: element.column("origin"),
            normal_sign: element.column("normal_sign"),
            birth_id: element.column("birth_id"),
            trained_pixel: element.column("trained_pixel"),
        })
    }
}

/// Reads the rows of a splat PLY whose header has been read.
pub(crate) fn read<R: BufRead>(source: &mut Source<'_, R>, header: &Header) -> Result<SplatFile> {
    let path = source.path;
    let Some(element) = header.element("vertex") else {
        let place = Place::Element("vertex".into());
        return Err(FormatError::defect(path, place, "nothing", "one row per Gaussian", "give a Gaussian splat"));
    };
    let columns = Columns::find(path, element)?;
    for before in header.elements.iter().take_while(|e| e.name != "vertex") {
        skip(source, before, header.encoding)?;
    }
    element.check_fits(path, header.encoding, source.remaining(), 0)?;
    let rows = row_count(path, "vertex", element.count)?;
    let degree = degree_of_rest(columns.rest.len()).unwrap_or(0);
    let mut gather = Gather::new(degree, rows);
    let mut extras = Extras::default();
    let mut coefficients = vec![0.0; 3 + columns.rest.len()];
    let stride = element.stride().unwrap_or(1);
    for_each_block(source, element, header.encoding, |block| {
        for row in block.chunks_exact(stride) {
            for (c, column) in coefficients.iter_mut().zip(columns.dc.iter().chain(&columns.rest)) {
                *c = column.f32(row);
            }
            let [a, b] = columns.scale.map(|c| c.f32(row));
            let c = columns.scale_2.map_or_else(|| a.min(b) + LN_FLAT, |c| c.f32(row));
            let mean = columns.mean.map(|c| c.f32(row));
            let rotation = columns.rotation.map(|c| c.f32(row));
            if gather.push(mean, [a, b, c], rotation, columns.opacity.f32(row), &coefficients) {
                extras.push(&mut gather.splats, &columns, row);
            }
        }
        Ok(())
    })?;
    let mut file = gather.finish(path, SplatFormat::Ply, element.count)?;
    file.report.replaced_attributes = extras.replaced;
    file.report.has_temperature = columns.temperature.is_some();
    (file.report.render_mode, file.report.antialiased) = rendering(header, columns.scale_2.is_none());
    Ok(file)
}

/// Optional attributes, each checked against its range.
#[derive(Default)]
struct Extras {
    replaced: u64,
}

impl Extras {
    #[inline(always)]
    fn push(&mut self, splats: &mut Splats, columns: &Columns, row: &[u8]) {
        if let Some(c) = columns.temperature {
            let t = c.f32(row);
            splats.temperature.push(self.keep(t.is_finite() && t > 0.0, t, AMBIENT_K));
        }
        if let Some(c) = columns.object_id {
            let v = c.u32(row);
            splats.object_id.push(self.keep(v <= u16::MAX.into(), v as u16, 0));
        }
        if let Some(c) = columns.phase {
            let v = c.u32(row);
            splats.phase.push(self.keep(v <= 3, v as u8, 0));
        }
        if let Some(c) = columns.origin {
            let v = c.u32(row);
            splats.origin.push(self.keep(v <= 2, v as u8, 0));
        }
        if let Some(c) = columns.normal_sign {
            let v = c.f64(row);
            splats.normal_sign.push(self.keep(v.abs() <= 1.0, v as i8, 0));
        }
        if let Some(c) = columns.birth_id {
            splats.birth_id.push(c.u32(row));
        }
        if let Some(c) = columns.trained_pixel {
            let v = c.f32(row);
            splats.trained_pixel.push(self.keep(v.is_finite() && v >= 0.0, v, 0.0));
        }
    }

    #[inline(always)]
    fn keep<T>(&mut self, good: bool, value: T, default: T) -> T {
        self.replaced += u64::from(!good);
        if good { value } else { default }
    }
}

/// Render mode and anti-aliasing as the header's comments tell them.
fn rendering(header: &Header, flat: bool) -> (RenderMode, bool) {
    let mut mode = if flat { RenderMode::Flat } else { RenderMode::Default };
    let mut antialiased = None;
    for comment in &header.comments {
        let mut words = comment.split(|c: char| c.is_whitespace() || c == ':').filter(|w| !w.is_empty());
        match (words.next(), words.next()) {
            (Some("SplatRenderMode"), Some("mip")) => mode = RenderMode::Mip,
            (Some("SplatRenderMode"), Some("2dgs")) => mode = RenderMode::Flat,
            (Some("antialiased"), Some(v)) => antialiased = Some(v == "1" || v == "true"),
            _ => {}
        }
    }
    (mode, antialiased.unwrap_or(mode == RenderMode::Mip))
}

/// Writes binary little-endian PLY in the ecosystem's order of properties.
pub(crate) fn write(splats: &Splats, options: &WriteOptions, w: &mut dyn Write) -> io::Result<()> {
    let rest = (sh::coefficients(splats.sh_degree) - 1) * 3;
    let per_channel = rest / 3;
    let mut header = format!("ply\nformat binary_little_endian 1.0\nelement vertex {}\n", splats.len());
    let mut float = |name: &str| {
        header.push_str("property float ");
        header.push_str(name);
        header.push('\n');
    };
    ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"].into_iter().for_each(&mut float);
    (0..rest).for_each(|i| float(&format!("f_rest_{i}")));
    ["opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"].into_iter().for_each(&mut float);
    if !options.strict {
        for p in [
            "float temperature",
            "ushort object_id",
            "uchar phase",
            "uchar origin",
            "char normal_sign",
            "uint birth_id",
            "float trained_pixel",
        ] {
            header.push_str(&format!("property {p}\n"));
        }
        // After the properties: some viewers read the count from the third line.
        header.push_str(&format!("comment SplatRenderMode: {}\n", options.render_mode.keyword()));
    }
    header.push_str("end_header\n");
    w.write_all(header.as_bytes())?;

    let mut block = Vec::with_capacity(1 << 16);
    for i in 0..splats.len() {
        let mut put = |values: &[f32]| values.iter().for_each(|v| block.extend_from_slice(&v.to_le_bytes()));
        put(&splats.mean[i]);
        // A normal whose side is not known is written as zero, as everybody does.
        put(&if splats.normal_sign[i] == 0 { [0.0; 3] } else { splats.normal(i) });
        let c = splats.sh_of(i);
        put(&c[..3]);
        for channel in 0..3 {
            for k in 0..per_channel {
                put(&c[3 + 3 * k + channel..][..1]);
            }
        }
        put(&[splats.opacity_logit[i]]);
        put(&splats.log_scale[i].map(|v| v.clamp(-LOG_SCALE, LOG_SCALE)));
        put(&splats.rotation[i]);
        if !options.strict {
            put(&[splats.temperature[i]]);
            block.extend_from_slice(&splats.object_id[i].to_le_bytes());
            block.extend_from_slice(&[splats.phase[i], splats.origin[i], splats.normal_sign[i] as u8]);
            block.extend_from_slice(&splats.birth_id[i].to_le_bytes());
            block.extend_from_slice(&splats.trained_pixel[i].to_le_bytes());
        }
        if block.len() > (1 << 16) - 512 {
            w.write_all(&block)?;
            block.clear();
        }
    }
    w.write_all(&block)
}
