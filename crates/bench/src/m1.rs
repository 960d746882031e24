//! Being written.

/// Options.
#[derive(clap::Args)]
pub struct Args {}

/// Runs the scene and returns its JSON line.
pub fn run(_args: &Args) -> String {
    String::new()
}
