//! What a hostile file may cost. Alone in its process, because it measures memory.
#![allow(missing_docs)]

use std::time::Instant;

use megas_formats::{load_splats, read_mesh_ply};
use tempfile::tempdir;

fn header(format: &str, count: u64, kind: &str) -> String {
    let names =
        ["x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"];
    let mut s = format!("ply\nformat {format} 1.0\nelement vertex {count}\n");
    names.iter().for_each(|n| s.push_str(&format!("property {kind} {n}\n")));
    s + "end_header\n"
}

/// Highest address space this process has ever had \[bytes\].
fn peak_memory() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|l| l.starts_with("VmPeak"))?;
    Some(line.split_whitespace().nth(1)?.parse::<u64>().ok()? << 10)
}

#[test]
fn enormous_claims_cost_nothing() {
    let dir = tempdir().unwrap();
    let mut cases = vec![
        "ply\nformat binary_little_endian 1.0\nelement vertex 4294967296\nproperty float x\nend_header\n".to_owned(),
        "ply\nformat binary_little_endian 1.0\nelement chunk 4294967296\nproperty float min_x\n\
             element vertex 4294967296\nproperty uint packed_position\nend_header\n"
            .into(),
        "ply\nformat ascii 1.0\nelement a 18446744073709551615\nproperty list uint float v\n\
             element vertex 1\nproperty float x\nend_header\n3 1 1 1\n"
            .into(),
    ];
    for format in ["ascii", "binary_little_endian", "binary_big_endian"] {
        for count in [1 << 32, 1 << 24, u64::MAX, u64::MAX / 56 + 1] {
            cases.push(header(format, count, "float") + "0 0");
            cases.push(header(format, count, "uchar") + "0 0");
        }
    }
    let path = dir.path().join("hostile.ply");
    let before = peak_memory();
    for text in &cases {
        std::fs::write(&path, text).unwrap();
        // The best of a few attempts: the machine may be busy with something else.
        let attempts = (0..5).map(|_| {
            let start = Instant::now();
            assert!(load_splats(&path).is_err(), "{text}");
            assert!(read_mesh_ply(&path).is_err());
            start.elapsed()
        });
        let best = attempts.min().unwrap();
        assert!(best.as_millis() < 10, "{best:?} for {text}");
    }
    if let (Some(a), Some(b)) = (before, peak_memory()) {
        assert!(b - a < 16 << 20, "{} MiB", (b - a) >> 20);
    }
}
