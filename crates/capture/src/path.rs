//! Names of files that come out of a capture's lists: relative, inside the folder, or refused.

use crate::error::{Fault, quoted};

/// Longest name that is believed \[bytes\].
pub(crate) const MAX_NAME: usize = 4096;

/// The name with forward slashes and without `.` components; a fault if it is empty, absolute or climbs out of the folder.
/// Lists written on Windows separate with backslashes, which no photograph's name holds otherwise.
pub(crate) fn relative(name: &str) -> Result<String, Fault> {
    let fault = |what: &str| {
        let remedy = "write the path of the image relative to the capture's folder";
        Err(Fault::new(format!("{what} {}", quoted(name)), "a relative path inside the capture's folder", remedy))
    };
    if name.len() > MAX_NAME {
        return fault("a very long name");
    }
    if name.chars().any(char::is_control) {
        return fault("control characters in");
    }
    let name_slashed = name.replace('\\', "/");
    let drive = name_slashed.as_bytes().get(1) == Some(&b':') && name_slashed.as_bytes()[0].is_ascii_alphabetic();
    if name_slashed.starts_with('/') || drive {
        return fault("an absolute path");
    }
    let parts: Vec<&str> = name_slashed.split('/').filter(|p| !p.is_empty() && *p != ".").collect();
    if parts.contains(&"..") {
        return fault("a path that leaves the folder:");
    }
    if parts.is_empty() {
        return fault("an empty name");
    }
    Ok(parts.join("/"))
}

#[cfg(test)]
mod tests {
    use super::relative;

    #[test]
    fn names_stay_inside_the_folder() {
        assert_eq!(relative("./train//r_0").unwrap(), "train/r_0");
        assert_eq!(relative("images\\a b.jpg").unwrap(), "images/a b.jpg");
        assert_eq!(relative("a..b/c.png").unwrap(), "a..b/c.png");
        for bad in ["", ".", "./", "/etc/passwd", "\\\\host\\x", "C:\\x.png", "../x.png", "a/../../x", "a\0b", "a\nb", &"x".repeat(5000)] {
            assert!(relative(bad).is_err(), "{bad:?}");
        }
    }
}
