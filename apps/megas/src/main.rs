//! The command line: parse, call the pipeline, print.

mod args;
mod claims_args;
mod console;
mod materials;
mod summary;
mod train_args;
mod validate;

use std::path::Path;
use std::process::ExitCode;

use clap::Parser;
use clap::error::ErrorKind;
use megas_pipeline::{Failure, LoadedScene, Options};
use serde_json::{Value, json};

use args::{Cli, Command, Global, Output, SceneArgs};
use console::{Console, print, print_error, print_json};

fn main() -> ExitCode {
    let cli = match Cli::try_parse() {
        Ok(cli) => cli,
        Err(e) => return usage(&e),
    };
    let json = cli.global.json;
    match execute(&cli) {
        Ok(answer) => {
            let code = answer.code();
            answer.print(cli.command.name(), &cli.global);
            code
        }
        Err(failure) => {
            print_error(&failure.to_string(), json);
            match failure {
                Failure::Input(_) => ExitCode::from(2),
                Failure::Interrupted(_) | Failure::Other(_) => ExitCode::from(1),
            }
        }
    }
}

/// Help, version, or a wrong command line. Machines get their error line too.
fn usage(e: &clap::Error) -> ExitCode {
    let answered = matches!(e.kind(), ErrorKind::DisplayHelp | ErrorKind::DisplayVersion);
    if !answered && std::env::args_os().any(|a| a == "--json") {
        // The first paragraph says what is wrong; usage and hints follow after an empty line.
        let text = e.render().to_string();
        let words: Vec<&str> = text.lines().map(str::trim).take_while(|l| !l.is_empty() && !l.starts_with("Usage")).collect();
        print_error(words.join(" ").trim_start_matches("error: "), true);
    } else {
        let _ = e.print();
    }
    if answered { ExitCode::SUCCESS } else { ExitCode::from(2) }
}

/// What a command has to say.
enum Answer {
    /// The figures of a run or an inspection.
    Figures(Value),
    /// A document to print as it is, with the object that stands for it among JSON lines.
    Document { text: String, object: Value },
    /// Figures of a comparison, and whether it came out well.
    Verdict { figures: Value, good: bool },
}

impl Answer {
    fn code(&self) -> ExitCode {
        if matches!(self, Self::Verdict { good: false, .. }) { ExitCode::from(1) } else { ExitCode::SUCCESS }
    }

    fn print(self, command: &str, global: &Global) {
        let (text, mut object) = match self {
            Self::Figures(figures) | Self::Verdict { figures, .. } => {
                (summary::table(&figures, global.verbose || figures["dry_run"] == true), figures)
            }
            // What was asked for is printed however quiet it should be.
            Self::Document { text, .. } if !global.json => return print(&text),
            Self::Document { text, object } => (text, object),
        };
        if global.json {
            if let Value::Object(map) = &mut object {
                map.insert("event".into(), "result".into());
                map.entry("command").or_insert_with(|| command.into());
            }
            print_json(&object);
        } else if !global.quiet {
            print(&text);
        }
    }
}

fn execute(cli: &Cli) -> Result<Answer, Failure> {
    let global = &cli.global;
    match &cli.command {
        Command::Demo { quick, output } => {
            let scene = megas_pipeline::demo_scene(*quick)?;
            on_scene(&scene, "demo", output, global, megas_pipeline::run)
        }
        Command::Inspect { file } => {
            let figures = megas_pipeline::inspect(file)?;
            let text = summary::table(&figures, true);
            Ok(Answer::Document { text, object: figures })
        }
        Command::Reconstruct(a) => {
            let job = a.job(global.threads);
            if a.dry_run {
                return megas_pipeline::plan_reconstruct(&job).map(planned);
            }
            console::stop_on_ctrl_c();
            megas_pipeline::reconstruct(&job, &Console::new(global)).map(Answer::Figures)
        }
        Command::Finetune(a) => {
            let job = a.job(global.threads);
            if a.dry_run {
                return megas_pipeline::plan_finetune(&job).map(planned);
            }
            console::stop_on_ctrl_c();
            megas_pipeline::finetune(&job, &Console::new(global)).map(Answer::Figures)
        }
        Command::Eval(args::Study::Reconstruct(a)) => {
            console::stop_on_ctrl_c();
            megas_pipeline::study(&a.job(global.threads), &Console::new(global)).map(Answer::Figures)
        }
        Command::Eval(args::Study::Claims(a)) => {
            console::stop_on_ctrl_c();
            megas_pipeline::claims(&a.job(global.threads), &Console::new(global)).map(Answer::Figures)
        }
        Command::Eval(args::Study::Figure(a)) => {
            let scene = match &a.scene {
                Some(file) => LoadedScene::open(file)?,
                None => megas_pipeline::demo_scene(a.quick)?,
            };
            let stem = Path::new(&a.figure).file_stem().unwrap_or("figure".as_ref()).to_string_lossy();
            let out = a.out.clone().unwrap_or_else(|| Path::new("megas-out").join(format!("figure-{stem}")));
            let options = Options { out, force: a.force, threads: global.threads.map(usize::from) };
            console::stop_on_ctrl_c();
            let job = megas_pipeline::FigureJob { figure: a.figure.clone(), scene, options };
            megas_pipeline::figure(&job, &Console::new(global)).map(Answer::Figures)
        }
        Command::Run(a) => on_file(a, global, megas_pipeline::run),
        Command::Fill(a) => on_file(a, global, megas_pipeline::fill),
        Command::Simulate(a) => on_file(a, global, megas_pipeline::simulate),
        Command::Render(a) => {
            let mut scene = LoadedScene::open(&a.scene.scene)?;
            a.apply(&mut scene.scene);
            let name = a.scene.scene.file_stem().unwrap_or("scene".as_ref()).to_string_lossy();
            on_scene(&scene, &name, &a.scene.output, global, megas_pipeline::render)
        }
        Command::Schema => {
            let schema = megas_scene::json_schema();
            Ok(Answer::Document { text: format!("{schema:#}\n"), object: json!({ "schema": schema }) })
        }
        Command::Validate(a) if a.list => Ok(Answer::Document { text: validate::list(), object: validate::list_json() }),
        Command::Validate(a) => validate::run(a, global).map(|(figures, good)| Answer::Verdict { figures, good }),
        Command::Materials => Ok(Answer::Document { text: materials::table(), object: json!({ "materials": materials::list() }) }),
    }
}

/// Marks the figures of a dry run.
fn planned(mut plan: Value) -> Answer {
    if let Value::Object(map) = &mut plan {
        map.insert("dry_run".into(), true.into());
    }
    Answer::Figures(plan)
}

type Stage = fn(&LoadedScene, &Options, &dyn megas_pipeline::Sink) -> Result<Value, Failure>;

fn on_file(a: &SceneArgs, global: &Global, stage: Stage) -> Result<Answer, Failure> {
    let scene = LoadedScene::open(&a.scene)?;
    let name = a.scene.file_stem().unwrap_or("scene".as_ref()).to_string_lossy();
    on_scene(&scene, &name, &a.output, global, stage)
}

fn on_scene(scene: &LoadedScene, name: &str, output: &Output, global: &Global, stage: Stage) -> Result<Answer, Failure> {
    let options = Options { out: output.folder(name), force: output.force, threads: global.threads.map(usize::from) };
    if output.dry_run {
        return megas_pipeline::plan(scene, &options).map(planned);
    }
    console::stop_on_ctrl_c();
    stage(scene, &options, &Console::new(global)).map(Answer::Figures)
}
