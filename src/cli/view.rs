//! `egotac view`.

use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Context, bail};

use super::doubt::Doubt;
use super::hands::Hands;
use crate::hand::{HandModel, Side, Topology};
use crate::label::FormatOptions;
use crate::model::{Precision, Predictor, shipped};
use crate::text::tell;
use crate::view::{ClipOptions, Feed, LiveFeed, LiveInput, Server, Settings, is_camera, open_clips, run_camera};

/// Arguments of `egotac view`.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Sources: a Zarr store, bag, LeRobot data set, video, folder of images, or a folder of these; a camera such as \
    /dev/video0; a ROS image topic such as /camera/image_raw (with the feature `ros`). Labels and truth of a source are shown; \
    where there are none, the network predicts touch. Touch that is not known is shown as unknown, never as zero.\n\
    The page is served on the loopback alone unless --listen says otherwise, and can change nothing."
)]
pub struct Args {
    /// Recordings, cameras and topics to show.
    #[arg(value_name = "SOURCE", required = true)]
    sources: Vec<String>,
    /// Address and port of the page; port 0 = any free one.
    #[arg(long, value_name = "ADDRESS:PORT", default_value = "127.0.0.1:7007")]
    listen: SocketAddr,
    /// Further name of this machine by which the page is asked for, beside its addresses and localhost.
    #[arg(long, value_name = "NAME")]
    host: Vec<String>,
    /// Checkpoint to predict touch with; by default the one shipped with egotac.
    #[arg(long, value_name = "FILE|shipped", value_parser = super::options::checkpoint())]
    checkpoint: Option<PathBuf>,
    /// Show labels and truth of the sources alone; load no network.
    #[arg(long, conflicts_with_all = ["checkpoint", "predict"])]
    labels_only: bool,
    /// Predict touch also where a source has predictions.
    #[arg(long)]
    predict: bool,
    /// Number format of the network: f32, bf16 or int8.
    #[arg(long, default_value = "f32")]
    precision: Precision,
    /// Index of the CUDA device; by default the CPU.
    #[arg(long, value_name = "INDEX")]
    cuda: Option<usize>,
    /// Array of a store's images, or key of a LeRobot camera.
    #[arg(long, value_name = "NAME")]
    camera: Option<String>,
    /// Topic of a bag's images; by default the only one.
    #[arg(long)]
    topic: Option<String>,
    /// Frame rate of a folder of images, 1/s; by default one image per observation step of the network.
    #[arg(long, value_name = "F", value_parser = super::positive)]
    fps: Option<f64>,
    /// Wanted size of a camera's images, pixels, such as 640x480.
    #[arg(long, value_name = "WIDTHxHEIGHT", value_parser = size)]
    size: Option<(u32, u32)>,
    /// Topic of touch by the node `predictor`, shown in place of a prediction of our own (ROS topics).
    #[arg(long, value_name = "TOPIC")]
    tactile: Option<String>,
    /// Topic of true touch (ROS topics).
    #[arg(long, value_name = "TOPIC")]
    truth: Option<String>,
    /// Topic of poses of the hands, HandPose (ROS topics).
    #[arg(long, value_name = "TOPIC")]
    hand_pose: Option<String>,
    /// Topic of poses of both hands, HandPoses (ROS topics).
    #[arg(long, value_name = "TOPIC")]
    hand_poses: Option<String>,
    #[command(flatten)]
    doubt: Doubt,
    #[command(flatten)]
    hands: Hands,
}

/// Runs the command until a signal ends it.
pub fn run(args: Args) -> anyhow::Result<ExitCode> {
    let predictor = match args.labels_only {
        true => None,
        false => Some(args.predictor()?),
    };
    let mut feeds = Vec::new();
    for source in &args.sources {
        args.open(source, predictor.as_ref(), &mut feeds).with_context(|| source.clone())?;
    }
    if !args.listen.ip().is_loopback() {
        tell(format_args!("warning: the page, with all images, is open to everyone who reaches {}", args.listen));
    }
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build()?;
    let settings = Settings { listen: args.listen, names: args.host.clone() };
    runtime.block_on(async {
        let server = Server::bind(&settings, feeds).await?;
        println!("http://{}/", server.address()?);
        let mut terminated = tokio::signal::unix::signal(tokio::signal::unix::SignalKind::terminate())?;
        tokio::select! {
            ended = server.run() => ended?,
            interrupted = tokio::signal::ctrl_c() => interrupted?,
            _ = terminated.recv() => {}
        }
        anyhow::Ok(())
    })?;
    // Threads that read recordings may be within a long read.
    runtime.shutdown_background();
    Ok(ExitCode::SUCCESS)
}

impl Args {
    /// Loads the network.
    fn predictor(&self) -> anyhow::Result<Predictor> {
        let path = self.checkpoint.clone().map_or_else(shipped::path, Ok)?;
        let options = crate::model::predictor::Options {
            device: super::device(self.cuda)?,
            precision: self.precision,
            ..super::predict::stream()
        };
        let mut predictor = Predictor::load(&path, self.doubt.apply(options))?;
        if let Some(warning) = predictor.warning() {
            tell(format_args!("warning: {warning}"));
        }
        if let Some(mano) = self.hands.map()? {
            predictor = predictor.with_mano(mano);
        }
        Ok(predictor)
    }

    /// Opens a source and adds its feeds.
    fn open(&self, source: &str, predictor: Option<&Predictor>, feeds: &mut Vec<Feed>) -> anyhow::Result<()> {
        let path = Path::new(source);
        if is_camera(path) {
            let (feed, input) = self.live(source, predictor)?;
            feeds.push(feed);
            let (path, size) = (path.to_path_buf(), self.size);
            return in_thread("camera", move || Ok(run_camera(&path, size, input)?));
        }
        if let Some(topic) = topic(source) {
            return self.open_topic(topic, predictor, feeds);
        }
        if !path.exists() {
            bail!(
                "there is no such file; a ROS topic is named by its full name, such as /camera/image_raw, or topic:NAME"
            );
        }
        let options = ClipOptions {
            predictor: predictor.cloned(),
            predicts_anew: self.predict,
            hands: self.hands.files()?,
            format: FormatOptions {
                fps: self.fps,
                frame_dt: 0.04,
                camera: self.camera.clone(),
                topic: self.topic.clone(),
                ..FormatOptions::default()
            },
        };
        for clip in open_clips(path, &options)? {
            feeds.push(Feed::recording(clip)?);
        }
        Ok(())
    }

    /// Creates both sides of a live source.
    fn live(&self, name: &str, predictor: Option<&Predictor>) -> anyhow::Result<(Feed, LiveInput)> {
        let hands = self.live_hands(predictor)?;
        let predictor = predictor.filter(|_| self.tactile.is_none()).cloned();
        let touch = self.tactile.clone().unwrap_or_else(|| "none".into());
        let (feed, input) = LiveFeed::new(name.to_owned(), predictor, hands, &touch);
        Ok((Feed::Live(feed), input))
    }

    /// Returns the hands that live touch is drawn on.
    fn live_hands(&self, predictor: Option<&Predictor>) -> anyhow::Result<[HandModel; 2]> {
        match self.hands.files()? {
            Some(hands) => Ok(hands),
            None if predictor.is_some_and(|predictor| predictor.topology() == Topology::Mano) => {
                bail!(
                    "the network's touch is on MANO's vertices; name your MANO files with --mano-left and --mano-right"
                )
            }
            None => Ok(Side::BOTH.map(HandModel::builtin)),
        }
    }

    #[cfg(feature = "ros")]
    fn open_topic(&self, source: &str, predictor: Option<&Predictor>, feeds: &mut Vec<Feed>) -> anyhow::Result<()> {
        use crate::node::viewer;

        let (feed, input) = self.live(source, predictor)?;
        feeds.push(feed);
        let topics = viewer::ViewTopics {
            image: source.to_owned(),
            tactile: self.tactile.clone(),
            truth: self.truth.clone(),
            hand_pose: self.hand_pose.clone(),
            hand_poses: self.hand_poses.clone(),
        };
        let models = self.live_hands(predictor)?;
        in_thread("topics", move || viewer::run(&topics, models, input, &viewer::shutdown()))
    }

    #[cfg(not(feature = "ros"))]
    fn open_topic(&self, source: &str, _: Option<&Predictor>, _: &mut Vec<Feed>) -> anyhow::Result<()> {
        bail!("there is no file {source}, and {}", super::feature_off("view TOPIC", "ros"))
    }
}

/// Runs a live source in a thread of its own; its error is printed, and its pages learn that the source has ended.
fn in_thread(name: &str, run: impl FnOnce() -> anyhow::Result<()> + Send + 'static) -> anyhow::Result<()> {
    let thread = std::thread::Builder::new().name(name.to_owned());
    thread.spawn(move || {
        if let Err(error) = run() {
            tell(format_args!("egotac: {}", crate::text::error_chain(error.as_ref())));
        }
    })?;
    Ok(())
}

/// Returns the ROS topic that `source` names: `topic:NAME`, or a full name that is not a file in an existing folder.
fn topic(source: &str) -> Option<&str> {
    if let Some(topic) = source.strip_prefix("topic:") {
        return Some(topic);
    }
    let path = Path::new(source);
    let is_name = source.starts_with('/') && source.chars().all(|c| c.is_ascii_alphanumeric() || "_/".contains(c));
    let in_folder = path.parent().is_some_and(|folder| folder != Path::new("/") && folder.is_dir());
    (is_name && !path.exists() && !in_folder).then_some(source)
}

fn size(text: &str) -> Result<(u32, u32), String> {
    let parsed = text.split_once('x').and_then(|(width, height)| Some((width.parse().ok()?, height.parse().ok()?)));
    parsed
        .filter(|(width, height)| *width > 0 && *height > 0)
        .ok_or_else(|| "expected WIDTHxHEIGHT, such as 640x480".into())
}
