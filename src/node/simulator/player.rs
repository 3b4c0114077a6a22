//! Playback of simulated episodes.

use std::sync::Arc;
use std::time::{Duration, Instant};

use anyhow::Context as _;

use super::outputs::Outputs;
use super::pace::{Pace, TIME_TOLERANCE_SECS};
use crate::node::diagnostics::Tally;
use crate::node::log::Log;
use crate::node::params::Parameters;
use crate::node::runtime::Runtime;
use crate::node::shutdown::Shutdown;
use crate::sim::{Rollout, RolloutOptions, Scene};

/// Delay between the last frame and the end of the node, so that its messages reach their subscribers.
const EXIT_DELAY: Duration = Duration::from_millis(500);
/// Time without new subscribers after which all nodes that started together count as connected.
const DISCOVERY_SETTLED_AFTER: Duration = Duration::from_millis(1500);
/// Time between two looks at the number of subscribers.
const DISCOVERY_POLL_INTERVAL: Duration = Duration::from_millis(20);
/// Time between two looks at the parameter `enabled` while it is false.
const PAUSE_POLL_INTERVAL: Duration = Duration::from_millis(10);

/// Plays episodes and publishes their frames. It runs on one worker thread, which owns the OpenGL context.
pub(super) struct Player {
    scenes: Vec<Scene>,
    /// Seed of the first episode.
    seed: u64,
    /// Number of episodes to play; 0 = no limit.
    episodes: u64,
    /// Simulated time to play, s; 0 = no limit.
    duration: f64,
    /// Longest wait for subscribers before the first frame.
    max_wait: Duration,
    /// Number of image subscribers to wait for.
    wait_listeners: usize,
    options: RolloutOptions,
    outputs: Outputs,
    pace: Pace,
    tally: Tally,
    parameters: Arc<Parameters>,
    log: Log,
}

/// Outcome of an episode.
enum Episode {
    /// All frames were published; holds the simulated length, s.
    Complete(f64),
    /// The node's time limit or the shutdown ended it.
    Stopped,
}

impl Player {
    /// Creates the publishers and reads the node's parameters; `tally` counts the frames.
    ///
    /// # Errors
    /// If ROS refuses a topic.
    pub(super) fn new(runtime: &mut Runtime, scenes: Vec<Scene>, tally: Tally) -> anyhow::Result<Self> {
        let parameters = runtime.parameters().clone();
        Ok(Self {
            outputs: Outputs::create(runtime, &parameters)?,
            pace: Pace::new(&parameters, runtime.clock().clone()),
            scenes,
            seed: u64::try_from(parameters.get::<i64>("seed"))?,
            episodes: u64::try_from(parameters.get::<i64>("episodes"))?,
            duration: parameters.get("duration"),
            max_wait: Duration::from_secs_f64(parameters.get("wait_secs")),
            wait_listeners: usize::try_from(parameters.get::<i64>("wait_listeners"))?,
            options: RolloutOptions {
                picture: Some((pixels(&parameters, "width")?, pixels(&parameters, "height")?)),
                sigma: parameters.get("sigma"),
                ..RolloutOptions::default()
            },
            tally,
            parameters: Arc::clone(runtime.parameters()),
            log: runtime.log().clone(),
        })
    }

    /// Plays episodes until the parameters' limit or `shutdown`.
    ///
    /// # Errors
    /// If a scene cannot be built or simulated, or a message cannot be published.
    pub(super) fn play(mut self, shutdown: &Shutdown) -> anyhow::Result<()> {
        let mut simulated = 0.0;
        for index in 0u64.. {
            if self.episodes > 0 && index == self.episodes {
                break;
            }
            match self.play_episode(index, simulated, shutdown)? {
                Episode::Complete(secs) => simulated += secs,
                Episode::Stopped => break,
            }
        }
        if !shutdown.requested() {
            std::thread::sleep(EXIT_DELAY);
        }
        Ok(())
    }

    /// Plays the episode `index`, which begins `before` simulated seconds after the first frame.
    fn play_episode(&mut self, index: u64, before: f64, shutdown: &Shutdown) -> anyhow::Result<Episode> {
        let scene = &self.scenes[(index % self.scenes.len() as u64) as usize];
        let seed = self.seed.wrapping_add(index);
        let name = scene.name.clone();
        let mut rollout =
            Rollout::new(scene, seed, &self.options).with_context(|| format!("scene {name} with seed {seed}"))?;
        if index == 0 {
            self.wait_for_subscribers(shutdown);
        }
        self.log.info(format!("episode {index}: {name}, seed {seed}, {} frames", rollout.frame_count()));
        let mut last = 0.0;
        while let Some(frame) = rollout.next_frame()? {
            let simulated = before + frame.frame.timestamp;
            if shutdown.requested() || (self.duration > 0.0 && simulated >= self.duration - TIME_TOLERANCE_SECS) {
                return Ok(Episode::Stopped);
            }
            self.wait_while_disabled(shutdown);
            self.tally.received();
            let stamp = self.pace.wait(simulated, shutdown);
            self.outputs.publish(&frame, &name, rollout.intrinsics(), stamp)?;
            self.tally.processed(None);
            self.tally.set_dropped("late", self.pace.late_frames());
            last = frame.frame.timestamp;
        }
        Ok(Episode::Complete(last + rollout.interval()))
    }

    /// Pauses while the parameter `enabled` is false; the frames that follow are paced from then on.
    fn wait_while_disabled(&mut self, shutdown: &Shutdown) {
        let paused = Instant::now();
        let mut has_waited = false;
        while !self.parameters.get::<bool>("enabled") && !shutdown.requested() {
            has_waited = true;
            std::thread::sleep(PAUSE_POLL_INTERVAL);
        }
        if has_waited {
            self.pace.resume(paused.elapsed());
        }
    }

    /// Waits until enough nodes subscribe to the images, then until no further node has joined for a moment, so that all
    /// nodes started together receive the first frame.
    fn wait_for_subscribers(&self, shutdown: &Shutdown) {
        let started = Instant::now();
        let (mut subscribers, mut last_joined) = (0, started);
        while started.elapsed() < self.max_wait && !shutdown.requested() {
            let now = self.outputs.subscribers();
            if now != subscribers {
                (subscribers, last_joined) = (now, Instant::now());
            }
            let enough = self.outputs.image_subscribers() >= self.wait_listeners;
            if enough && last_joined.elapsed() > DISCOVERY_SETTLED_AFTER {
                break;
            }
            std::thread::sleep(DISCOVERY_POLL_INTERVAL);
        }
    }
}

fn pixels(parameters: &Parameters, name: &str) -> anyhow::Result<u32> {
    Ok(u32::try_from(parameters.get::<i64>(name))?)
}
