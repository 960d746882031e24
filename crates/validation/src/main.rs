//! Prints the validation table for a person, or as JSON.

use std::time::Instant;

use clap::Parser;
use megas_validation::{Tier, cases};

/// Compare the simulator with analytic and published references
#[derive(Parser)]
struct Cli {
    /// Only this case, for example V12 (repeatable)
    #[arg(long = "case")]
    only: Vec<String>,
    /// Include the cases that take longer than a minute
    #[arg(long)]
    full: bool,
    /// One JSON object per row
    #[arg(long)]
    json: bool,
}

fn main() {
    let cli = Cli::parse();
    let mut failed = 0;
    if !cli.json {
        println!("{:<5} {:<58} {:>13} {:>13} {:>10}  {:>7}", "case", "quantity", "reference", "ours", "tolerance", "seconds");
    }
    for case in cases() {
        let wanted =
            if cli.only.is_empty() { cli.full || case.tier < Tier::C } else { cli.only.iter().any(|c| c.eq_ignore_ascii_case(case.id)) };
        if !wanted {
            continue;
        }
        let start = Instant::now();
        let rows = (case.run)().rows;
        let seconds = start.elapsed().as_secs_f64();
        for row in rows {
            let ok = row.passed();
            failed += usize::from(!ok);
            if cli.json {
                println!("{}", serde_json::json!({"case": case.id, "name": case.name, "row": row, "passed": ok, "seconds": seconds}));
            } else {
                let mark = if ok { "" } else { "  FAILED" };
                println!(
                    "{:<5} {:<58} {:>13.6e} {:>13.6e} {:>10.1e}  {:>7.2}{mark}",
                    case.id, row.quantity, row.reference, row.ours, row.tolerance, seconds
                );
            }
        }
    }
    if failed > 0 {
        eprintln!("{failed} rows outside their tolerance");
        std::process::exit(1);
    }
}
