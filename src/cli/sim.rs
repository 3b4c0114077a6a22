//! `egotac sim`: simulated hand-object scenes.

use std::path::PathBuf;
use std::process::ExitCode;

use super::hands::Hands;

/// Arguments of `egotac sim`.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, clap::Subcommand)]
enum Command {
    /// List the scenes that are part of the program.
    List,
    /// Render a scene to a PNG: one instant, or a sheet of several.
    Show(Show),
    /// Say which effects a scene simulates, why, and what each costs.
    Explain(Explain),
    /// Simulate one episode and write it as a Zarr store.
    Run(Run),
    /// Simulate many episodes and write them as one Zarr store; the same command continues an interrupted one.
    Generate(Generate),
    /// What `generate` starts: records the episodes that it is told on standard input.
    #[command(hide = true)]
    Worker(Worker),
}

#[derive(Debug, clap::Args)]
struct Show {
    /// Name of a scene (`egotac sim list`), or a YAML file.
    scene: String,
    /// Seed of everything the scene leaves open.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Simulated time to show, s; without it, the middle of the episode.
    #[arg(long, conflicts_with = "sheet")]
    time: Option<f64>,
    /// Show this many instants side by side, evenly spread over the episode.
    #[arg(long)]
    sheet: Option<usize>,
    /// Paint where the hand is touched: force of label c on the vertices, projected into the picture.
    #[arg(long)]
    touch: bool,
    /// List the contacts of each instant: bodies, normal force, depth.
    #[arg(long)]
    contacts: bool,
    /// Draw shadows (ten times slower).
    #[arg(long)]
    shadows: bool,
    /// Width and height of a picture, pixels.
    #[arg(long, default_value_t = 448)]
    size: u32,
    /// PNG file to write.
    #[arg(long)]
    out: PathBuf,
    #[command(flatten)]
    hands: Hands,
}

#[derive(Debug, clap::Args)]
struct Explain {
    /// Name of a scene (`egotac sim list`), or a YAML file.
    scene: String,
    /// Seed of the episode in which costs are measured.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Width and height of the picture, pixels.
    #[arg(long, default_value_t = 224)]
    size: u32,
    /// Leave the costs away.
    #[arg(long)]
    no_cost: bool,
    /// Print JSON in place of the table.
    #[arg(long)]
    json: bool,
}

#[derive(Debug, clap::Args)]
struct Run {
    /// Name of a scene (`egotac sim list`), or a YAML file.
    scene: String,
    /// Seed of everything the scene leaves open.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Width and height of the picture, pixels.
    #[arg(long, default_value_t = 224)]
    size: u32,
    /// Draw shadows (ten times slower).
    #[arg(long)]
    shadows: bool,
    /// Store to write; must not exist.
    #[arg(long)]
    out: PathBuf,
    #[command(flatten)]
    accuracy: Accuracy,
    #[command(flatten)]
    hands: Hands,
}

#[derive(Debug, clap::Args)]
struct Generate {
    /// Names of scenes, or YAML files; taken in turn.
    #[arg(required = true)]
    scenes: Vec<String>,
    /// Episodes altogether.
    #[arg(long, default_value_t = 100)]
    episodes: usize,
    /// Seed of the first episode; each further one has the next.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Width and height of the picture, pixels.
    #[arg(long, default_value_t = 112)]
    size: u32,
    /// Draw shadows (ten times slower).
    #[arg(long)]
    shadows: bool,
    /// Episodes simulated at a time, each in a process of its own.
    #[arg(long, default_value_t = 2)]
    jobs: usize,
    /// Simulate in threads of this process: if the engine ends one episode, it ends all.
    #[arg(long)]
    in_process: bool,
    /// Leave out episodes that fail, and name them, instead of writing no store.
    #[arg(long, conflicts_with = "in_process")]
    skip_failed: bool,
    /// Store to write; must not exist.
    #[arg(long)]
    out: PathBuf,
    #[command(flatten)]
    accuracy: Accuracy,
    #[command(flatten)]
    hands: Hands,
}

/// How exact the physics is, in place of what the scene says.
#[derive(Debug, clap::Args)]
struct Accuracy {
    /// Physics preset: replay, fast, default, precise, reference or stiff.
    #[arg(long, conflicts_with_all = ["budget", "error"])]
    preset: Option<String>,
    /// Computation per simulated second at most, without labels and pictures, e.g. 20ms: takes the most exact preset
    /// within it, by the table of `egotac bench sim` that is part of the program.
    #[arg(long, value_name = "TIME", value_parser = parse_budget)]
    budget: Option<f64>,
    /// Error of quasi-static forces at most, e.g. 1%: takes the cheapest preset that keeps it, by the same table.
    #[arg(long, value_name = "PERCENT", value_parser = parse_error)]
    error: Option<f64>,
}

#[derive(Debug, clap::Args)]
struct Worker {
    /// Names of scenes, or YAML files.
    #[arg(required = true)]
    scenes: Vec<String>,
    /// Width and height of the picture, pixels.
    #[arg(long)]
    size: u32,
    /// Draw shadows.
    #[arg(long)]
    shadows: bool,
    #[command(flatten)]
    accuracy: Accuracy,
    #[command(flatten)]
    hands: Hands,
}

/// Reads seconds with their unit: `20ms`, `0.5s`.
fn parse_budget(text: &str) -> Result<f64, String> {
    let number = |text: &str| text.trim().parse::<f64>().ok();
    let seconds = match text.strip_suffix("ms") {
        Some(text) => number(text).map(|ms| 1e-3 * ms),
        None => text.strip_suffix('s').and_then(number),
    };
    let expected = "expected a time above 0 with its unit, such as 20ms or 0.5s";
    seconds.filter(|s| s.is_finite() && *s > 0.0).ok_or_else(|| expected.into())
}

/// Reads a share in percent: `1%`.
fn parse_error(text: &str) -> Result<f64, String> {
    let share = text.strip_suffix('%').and_then(|text| text.trim().parse::<f64>().ok()).map(|value| value / 100.0);
    share.filter(|s| s.is_finite() && *s >= 0.0).ok_or_else(|| "expected a share in percent, such as 1%".into())
}

/// Runs the command.
#[cfg(not(feature = "sim"))]
pub fn run(args: Args) -> anyhow::Result<ExitCode> {
    let name = match args.command {
        Command::List => "sim list",
        Command::Show(_) => "sim show",
        Command::Explain(_) => "sim explain",
        Command::Run(_) => "sim run",
        Command::Generate(_) => "sim generate",
        Command::Worker(_) => "sim worker",
    };
    Err(super::feature_off(name, "sim"))
}

/// Runs the command.
#[cfg(feature = "sim")]
pub fn run(args: Args) -> anyhow::Result<ExitCode> {
    match args.command {
        Command::List => with_sim::list()?,
        Command::Show(args) => with_sim::show(&args)?,
        Command::Explain(args) => with_sim::explain(&args)?,
        Command::Run(args) => with_sim::run(&args)?,
        Command::Generate(args) => with_sim::generate(&args)?,
        Command::Worker(args) => with_sim::work(&args)?,
    }
    Ok(ExitCode::SUCCESS)
}

#[cfg(feature = "sim")]
mod with_sim {
    use std::ffi::OsString;
    use std::path::Path;

    use ::image::{GenericImage, Rgb, RgbImage};
    use anyhow::{Context, ensure};
    use indicatif::{ProgressBar, ProgressStyle};

    use super::{Accuracy, Explain, Generate, Hands, Run, Show, Worker};
    use crate::bench::sim::pick::{self, Request};
    use crate::file;
    use crate::hand::Side;
    use crate::mujoco::{PhysicsOptions, Preset};
    use crate::sim::{self, Rollout, RolloutOptions, SHIPPED, Scene, SimFrame, Summary, Workers};

    pub fn list() -> anyhow::Result<()> {
        let width = SHIPPED.iter().map(|(name, _)| name.len()).max().unwrap_or(0);
        for (name, _) in SHIPPED {
            println!("{name:width$}  {}", Scene::load(name)?.spec.description);
        }
        Ok(())
    }

    pub fn show(args: &Show) -> anyhow::Result<()> {
        let mut rollout =
            Rollout::new(&Scene::load(&args.scene)?, args.seed, &options(&args.hands, args.size, args.shadows)?)?;
        let frames = rollout.frame_count();
        let instants: Vec<usize> = match (args.time, args.sheet) {
            (Some(time), _) => {
                let last = (frames - 1) as f64 * rollout.interval();
                ensure!((0.0..=last + 1e-9).contains(&time), "--time: expected 0 to {last:.2} s, got {time}");
                vec![(time / rollout.interval()).round() as usize]
            }
            (None, Some(count)) => {
                ensure!((1..=100).contains(&count), "--sheet: expected 1 to 100 pictures, got {count}");
                (0..count).map(|i| (i * 2 + 1) * (frames - 1) / (2 * count)).collect()
            }
            (None, None) => vec![frames / 2],
        };
        let columns = (instants.len() as f64).sqrt().ceil() as u32;
        let rows = (instants.len() as u32).div_ceil(columns);
        let mut sheet = RgbImage::new(columns * args.size, rows * args.size);
        let mut at = 0;
        for (i, instant) in instants.iter().enumerate() {
            while at < *instant {
                ensure!(rollout.skip_frame(), "the simulation ended early, at {:.2} s", rollout.world().time());
                at += 1;
            }
            let frame = rollout.next_frame()?.context("the simulation ended early")?;
            at += 1;
            let mut picture = frame.frame.camera_ego_rgb.clone();
            if args.touch {
                paint_touch(&mut picture, &frame, &rollout);
            }
            let (x, y) = (i as u32 % columns * args.size, i as u32 / columns * args.size);
            sheet.copy_from(&picture, x, y)?;
            let total: f64 = frame.hands.iter().flatten().map(|hand| hand.total).sum();
            println!(
                "t = {:.2} s: {:.2} N on the hands, {} vertices in contact",
                frame.frame.timestamp,
                total,
                touched(&frame)
            );
            if args.contacts {
                print_contacts(&rollout);
            }
        }
        write_png(&sheet, &args.out)
    }

    fn print_contacts(rollout: &Rollout) {
        let world = rollout.world();
        for contact in world.contacts() {
            let [a, b] = contact.bodies.map(|body| world.body_name(body));
            let depth = -1e3 * contact.distance;
            println!("  {a:16} {b:16} {:7.3} N {depth:6.2} mm deep", contact.normal_force);
        }
    }

    pub fn explain(args: &Explain) -> anyhow::Result<()> {
        let scene = Scene::load(&args.scene)?;
        let hands = Hands::default();
        let options = options(&hands, args.size, false)?;
        let mut effects = sim::explain::explain(&scene)?;
        if !args.no_cost {
            let bar = progress_bar("effects");
            for (done, explained) in effects.iter_mut().enumerate() {
                step(&bar, done, sim::Effect::ALL.len());
                explained.cost = Some(sim::explain::cost(&scene, args.seed, &options, explained.effect)?);
            }
            bar.finish_and_clear();
        }
        println!("{}", if args.json { as_json(&effects)? } else { as_table(&effects) });
        Ok(())
    }

    fn as_json(effects: &[sim::explain::Explained]) -> anyhow::Result<String> {
        let entry = |e: &sim::explain::Explained| {
            serde_json::json!({
                "effect": e.effect.name(), "on": e.on, "reason": e.reason, "ms_per_simulated_second": e.cost,
            })
        };
        Ok(serde_json::to_string_pretty(&effects.iter().map(entry).collect::<Vec<_>>())?)
    }

    /// A table for people; the cost of what is off stands in brackets.
    fn as_table(effects: &[sim::explain::Explained]) -> String {
        let row = |[a, b, c, d]: [&str; 4]| format!("{a:18}  {b:3}  {c:>10}  {d}");
        let mut lines = vec![row(["effect", "", "ms/s", "why"])];
        for explained in effects {
            let cost = match explained.cost {
                Some(cost) if explained.on => format!("{cost:.1}"),
                Some(cost) => format!("({cost:.1})"),
                None => String::new(),
            };
            let on = if explained.on { "on" } else { "off" };
            lines.push(row([explained.effect.name(), on, &cost, &explained.reason]));
        }
        lines.push("ms/s: milliseconds per simulated second, with what comes and goes with the effect; (in brackets): what it would cost".into());
        lines.join("\n")
    }

    pub fn run(args: &Run) -> anyhow::Result<()> {
        let scene = told(Scene::load(&args.scene)?, &args.accuracy)?;
        let bar = progress_bar("frames");
        let options = options(&args.hands, args.size, args.shadows)?;
        let summary = sim::record(&scene, args.seed, &options, &args.out, |done, all| step(&bar, done, all))?;
        bar.finish_and_clear();
        print(&summary, &args.out);
        Ok(())
    }

    pub fn generate(args: &Generate) -> anyhow::Result<()> {
        let scenes = args.scenes.iter().map(|name| told(Scene::load(name)?, &args.accuracy));
        let plan = sim::Generate {
            scenes: scenes.collect::<anyhow::Result<_>>()?,
            episodes: args.episodes,
            seed: args.seed,
            jobs: args.jobs,
            options: options(&args.hands, args.size, args.shadows)?,
        };
        let bar = progress_bar("episodes");
        let progress = |done, all| step(&bar, done, all);
        let summary = match args.in_process {
            true => sim::generate(&plan, &args.out, progress)?,
            false => sim::generate_isolated(&plan, &workers(args)?, args.skip_failed, &args.out, progress)?,
        };
        bar.finish_and_clear();
        print(&summary, &args.out);
        Ok(())
    }

    /// This program with the same scenes and options.
    fn workers(args: &Generate) -> anyhow::Result<Workers> {
        let program = std::env::current_exe().context("where this program lies")?;
        let mut arguments: Vec<OsString> = ["sim", "worker"].map(OsString::from).to_vec();
        arguments.extend(["--size".into(), args.size.to_string().into()]);
        if args.shadows {
            arguments.push("--shadows".into());
        }
        let Accuracy { preset, budget, error } = &args.accuracy;
        let preset = preset.clone().map(|name| ("--preset", name));
        let budget = budget.map(|seconds| ("--budget", format!("{seconds}s")));
        let error = error.map(|share| ("--error", format!("{}%", 100.0 * share)));
        for (flag, value) in [preset, budget, error].into_iter().flatten() {
            arguments.extend([flag.into(), value.into()]);
        }
        for (flag, path) in [("--mano-left", &args.hands.mano_left), ("--mano-right", &args.hands.mano_right)] {
            arguments.extend(path.iter().flat_map(|path| [flag.into(), path.clone().into_os_string()]));
        }
        arguments.push("--".into());
        arguments.extend(args.scenes.iter().map(OsString::from));
        Ok(Workers { program, arguments })
    }

    pub fn work(args: &Worker) -> anyhow::Result<()> {
        let scenes = args.scenes.iter().map(|name| Ok(with_accuracy(Scene::load(name)?, &args.accuracy)?.0));
        let scenes = scenes.collect::<anyhow::Result<Vec<_>>>()?;
        let options = options(&args.hands, args.size, args.shadows)?;
        sim::isolate::serve(&scenes, &options, std::io::stdin().lock(), std::io::stdout().lock())?;
        Ok(())
    }

    /// As [`with_accuracy`], which is told.
    fn told(scene: Scene, accuracy: &Accuracy) -> anyhow::Result<Scene> {
        let (scene, news) = with_accuracy(scene, accuracy)?;
        news.iter().for_each(|line| println!("{line}"));
        Ok(scene)
    }

    /// The scene with the preset that is asked for or follows from the bench's table, and what a user should hear of it.
    fn with_accuracy(mut scene: Scene, accuracy: &Accuracy) -> anyhow::Result<(Scene, Vec<String>)> {
        let mut news = Vec::new();
        let request = Request { budget: accuracy.budget, error: accuracy.error };
        let preset = match &accuracy.preset {
            Some(name) => Preset::from_name(name)?,
            None if request == Request::default() => return Ok((scene, news)),
            None => {
                let choice = pick::pick(&pick::committed()?, &scene.name, request)?;
                news.push(format!("{}: preset {choice}: {}, by {}", scene.name, choice.reason, choice.basis));
                choice.preset
            }
        };
        let physics = &scene.spec.physics;
        if *physics != PhysicsOptions::preset(physics.preset) {
            news.push(format!("{}: its own physics values give way to the preset's, except gravity", scene.name));
        }
        scene.spec.physics = physics.with_preset(preset);
        let interval = 1.0 / scene.spec.rate;
        scene
            .spec
            .physics
            .steps_in(interval)
            .with_context(|| format!("{} with preset {}", scene.name, preset.name()))?;
        Ok((scene, news))
    }

    fn options(hands: &Hands, size: u32, shadows: bool) -> anyhow::Result<RolloutOptions> {
        let most = sim::mjcf::MAX_PICTURE;
        ensure!((8..=most).contains(&size), "--size: expected 8 to {most} pixels, got {size}");
        Ok(RolloutOptions { hands: hands.models()?, picture: Some((size, size)), shadows, ..RolloutOptions::default() })
    }

    fn touched(frame: &SimFrame) -> usize {
        frame.frame.field.contact.iter().filter(|c| **c > 0.5).count()
    }

    /// A disc on each vertex in contact, from yellow to red with its force.
    fn paint_touch(picture: &mut RgbImage, frame: &SimFrame, rollout: &Rollout) {
        for side in Side::BOTH {
            let Some(params) = rollout.hand_params(side) else { continue };
            let vertices = rollout.rigs()[side as usize].model.forward(&params).vertices;
            for (vertex, force) in vertices.iter().zip(&frame.frame.field.force[side.range()]) {
                let local = frame.camera.camera_from_world(vertex.as_dvec3());
                let Some([x, y]) =
                    rollout.intrinsics().project(local).filter(|_| *force > crate::tactile::CONTACT_FORCE_N)
                else {
                    continue;
                };
                let green = (230.0 * (1.0 - force / 0.6).clamp(0.0, 1.0)) as u8;
                let radius = f64::from(picture.width()) / 180.0;
                let reach = radius.ceil() as i64;
                for (dx, dy) in (-reach..=reach).flat_map(|dx| (-reach..=reach).map(move |dy| (dx, dy))) {
                    let (px, py) = (x as i64 + dx, y as i64 + dy);
                    let inside = px >= 0 && py >= 0 && px < picture.width().into() && py < picture.height().into();
                    if inside && ((dx * dx + dy * dy) as f64) <= radius * radius {
                        picture.put_pixel(px as u32, py as u32, Rgb([255, green, 0]));
                    }
                }
            }
        }
    }

    fn write_png(picture: &RgbImage, out: &Path) -> anyhow::Result<()> {
        file::write_png(out, picture)?;
        println!("wrote {}", out.display());
        Ok(())
    }

    fn print(summary: &Summary, out: &Path) {
        println!(
            "wrote {}: {} frames, {} with touch; most force {:.2} N; residuals: sum {:.1e}, moment {:.1e} N m",
            out.display(),
            summary.frames,
            summary.touching,
            summary.max_force,
            summary.sum_residual,
            summary.moment_residual,
        );
        for failed in &summary.failed {
            println!("left out: {failed}");
        }
        for (reason, count) in &summary.invalid {
            println!("{count} frames not valid: {reason}");
        }
    }

    fn progress_bar(unit: &str) -> ProgressBar {
        let bar = ProgressBar::new(0);
        let template = format!("{{bar:40}} {{pos}}/{{len}} {unit} {{per_sec}} {{eta}} left");
        if let Ok(style) = ProgressStyle::with_template(&template) {
            bar.set_style(style);
        }
        bar
    }

    fn step(bar: &ProgressBar, done: usize, all: usize) {
        bar.set_length(all as u64);
        bar.set_position(done as u64);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn budgets_and_errors_need_their_units() {
        for (text, seconds) in [("20ms", 0.02), ("0.5s", 0.5), ("1.5 ms", 0.0015)] {
            assert!((parse_budget(text).unwrap() - seconds).abs() < 1e-12, "{text}");
        }
        for text in ["20", "ms", "-1ms", "0s", "infs", "20us", "NaNs", ""] {
            assert!(parse_budget(text).is_err(), "{text}");
        }
        assert!((parse_error("1%").unwrap() - 0.01).abs() < 1e-12 && parse_error("0.5 %").unwrap() == 0.005);
        for text in ["1", "0.01", "-1%", "%", "inf%", "one%"] {
            assert!(parse_error(text).is_err(), "{text}");
        }
    }
}
