//! Progress and messages: bars on a terminal, a few plain lines elsewhere, JSON lines for machines.

use std::io::{self, IsTerminal, Write};
use std::path::Path;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressState, ProgressStyle};
use megas_pipeline::{Event, Sink};
use serde_json::{Value, json};

use crate::args::Global;

/// Shortest time between two JSON lines about steps.
const STEP_INTERVAL: Duration = Duration::from_millis(250);

/// Set by Ctrl-C; the pipeline asks for it between steps.
static STOP: AtomicBool = AtomicBool::new(false);

/// A second Ctrl-C sooner than this belongs to the first: some programs signal both a process and its group.
const SAME_STOP: Duration = Duration::from_millis(500);

/// Makes Ctrl-C ask for a stop; a second one ends the program at once (files are written such that this costs only the current step).
pub fn stop_on_ctrl_c() {
    let mut first: Option<Instant> = None;
    // Without a handler Ctrl-C simply ends the program, and the run can still be resumed.
    let _ = ctrlc::set_handler(move || {
        STOP.store(true, Ordering::SeqCst);
        if first.get_or_insert_with(Instant::now).elapsed() > SAME_STOP {
            std::process::exit(1);
        }
    });
}

/// Writes to standard output. A reader that went away (`megas schema | head`) is no error.
pub fn print(text: &str) {
    let mut out = io::stdout().lock();
    let _ = out.write_all(text.as_bytes()).and_then(|()| out.flush());
}

/// Writes one JSON line.
pub fn print_json(value: &Value) {
    print(&format!("{value}\n"));
}

fn complain(text: &str) {
    let _ = writeln!(io::stderr().lock(), "{text}");
}

/// Says why a command failed.
pub fn print_error(message: &str, json: bool) {
    if json {
        print_json(&json!({ "event": "error", "message": message }));
    } else {
        complain(&format!("error: {message}"));
    }
}

enum Mode {
    /// JSON lines on standard output.
    Json,
    /// Bars on standard error.
    Bars,
    /// A line at the beginning and end of every stage on standard error.
    Lines,
    /// Warnings only.
    Quiet,
}

struct Stage {
    name: String,
    steps: u64,
    bar: Option<ProgressBar>,
    last_step: Option<Instant>,
    /// Live figures of the stage.
    live: Vec<(&'static str, f64)>,
}

/// The program's end of the pipeline's events.
pub struct Console {
    mode: Mode,
    verbose: bool,
    stage: Mutex<Stage>,
}

impl Console {
    /// The console that the options ask for.
    pub fn new(options: &Global) -> Self {
        let mode = match options {
            Global { json: true, .. } => Mode::Json,
            Global { quiet: true, .. } => Mode::Quiet,
            _ if io::stderr().is_terminal() => Mode::Bars,
            _ => Mode::Lines,
        };
        let stage = Stage { name: String::new(), steps: 0, bar: None, last_step: None, live: Vec::new() };
        Self { mode, verbose: options.verbose, stage: Mutex::new(stage) }
    }

    fn with_stage<R>(&self, f: impl FnOnce(&mut Stage) -> R) -> R {
        // A panic elsewhere must not hide the messages that explain it.
        f(&mut self.stage.lock().unwrap_or_else(std::sync::PoisonError::into_inner))
    }

    /// A line for people above a bar that may be running.
    fn say(&self, text: &str) {
        self.with_stage(|s| match &s.bar {
            Some(bar) => bar.suspend(|| complain(text)),
            None => complain(text),
        });
    }

    /// A part of the answer that is ready before the rest, on standard output.
    pub fn answer(&self, text: &str) {
        if matches!(self.mode, Mode::Bars | Mode::Lines) {
            self.with_stage(|s| match &s.bar {
                Some(bar) => bar.suspend(|| print(text)),
                None => print(text),
            });
        }
    }

    /// What is being done, beside the bar.
    pub fn doing(&self, text: &str) {
        self.with_stage(|s| {
            if let Some(bar) = &s.bar {
                bar.set_message(text.to_owned());
            }
        });
    }

    fn begin(&self, name: &str, steps: u64) {
        let bar = matches!(self.mode, Mode::Bars).then(|| new_bar(name, steps));
        self.with_stage(|s| {
            if let Some(old) = s.bar.take() {
                old.finish_and_clear();
            }
            *s = Stage { name: name.into(), steps, bar, last_step: None, live: Vec::new() };
        });
        match self.mode {
            Mode::Json => print_json(&json!({ "event": "stage", "name": name, "steps": steps })),
            Mode::Lines => complain(&format!("{name} …")),
            Mode::Bars | Mode::Quiet => {}
        }
    }

    fn step(&self, done: u64) {
        let line = self.with_stage(|s| {
            if let Some(bar) = &s.bar {
                bar.set_position(done);
            }
            let due = s.last_step.is_none_or(|t| t.elapsed() >= STEP_INTERVAL) || (s.steps > 0 && done >= s.steps);
            if !matches!(self.mode, Mode::Json) || !due {
                return None;
            }
            s.last_step = Some(Instant::now());
            let mut line = json!({ "event": "step", "stage": s.name, "done": done, "steps": s.steps });
            s.live.iter().for_each(|(name, value)| line[*name] = json!(value));
            Some(line)
        });
        if let Some(line) = line {
            print_json(&line);
        }
    }

    fn live(&self, figures: &[(&'static str, f64)]) {
        self.with_stage(|s| {
            s.live = figures.to_vec();
            if let Some(bar) = &s.bar {
                let one = |(name, value): &(&str, f64)| format!("{name} {}", crate::summary::figure(name, *value));
                bar.set_message(figures.iter().map(one).collect::<Vec<_>>().join("  "));
            }
        });
    }

    fn end(&self, name: &str, seconds: f64) {
        self.with_stage(|s| {
            if let Some(bar) = s.bar.take() {
                bar.finish_and_clear();
            }
        });
        match self.mode {
            Mode::Json => print_json(&json!({ "event": "stage_done", "name": name, "seconds": seconds })),
            Mode::Bars | Mode::Lines => complain(&format!("{name}: {}", crate::summary::duration(seconds))),
            Mode::Quiet => {}
        }
    }

    fn message(&self, kind: &str, text: &str) {
        match self.mode {
            Mode::Json => print_json(&json!({ "event": kind, "message": text })),
            _ if kind == "warning" => self.say(&format!("warning: {text}")),
            Mode::Bars | Mode::Lines if self.verbose => self.say(&format!("note: {text}")),
            _ => {}
        }
    }

    fn file(&self, path: &Path) {
        match self.mode {
            Mode::Json => print_json(&json!({ "event": "file", "path": path.display().to_string() })),
            Mode::Bars | Mode::Lines if self.verbose => self.say(&format!("wrote {}", path.display())),
            _ => {}
        }
    }
}

impl Sink for Console {
    fn event(&self, event: Event<'_>) {
        match event {
            Event::Stage { name, steps } => self.begin(name, steps),
            Event::Step { done } => self.step(done),
            Event::Live(figures) => self.live(figures),
            Event::StageDone { name, seconds } => self.end(name, seconds),
            Event::Note(text) => self.message("note", text),
            Event::Warning(text) => self.message("warning", text),
            Event::File(path) => self.file(path),
        }
    }

    fn cancelled(&self) -> bool {
        STOP.load(Ordering::Relaxed)
    }
}

impl Drop for Console {
    fn drop(&mut self) {
        self.with_stage(|s| {
            if let Some(bar) = s.bar.take() {
                bar.finish_and_clear();
            }
        });
    }
}

/// The time left; nothing is known before the first step.
fn time_left(state: &ProgressState, out: &mut dyn std::fmt::Write) {
    let _ = match state.pos() {
        0 => out.write_str("estimating"),
        _ => write!(out, "{} left", crate::summary::duration(state.eta().as_secs_f64().ceil())),
    };
}

fn new_bar(name: &str, steps: u64) -> ProgressBar {
    let target = ProgressDrawTarget::stderr_with_hz(8);
    let (bar, template) = match steps {
        0 => (ProgressBar::no_length(), "{prefix:<10} {spinner} {elapsed}"),
        _ => (ProgressBar::new(steps), "{prefix:<10} [{bar:32}] {pos}/{len}  {elapsed} gone, {left}  {wide_msg}"),
    };
    bar.set_draw_target(target);
    if let Ok(style) = ProgressStyle::with_template(template) {
        bar.set_style(style.progress_chars("=> ").with_key("left", time_left));
    }
    bar.set_prefix(name.to_owned());
    // Keeps the clock running through long steps.
    bar.enable_steady_tick(Duration::from_millis(500));
    bar
}
