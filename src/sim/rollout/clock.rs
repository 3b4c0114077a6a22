//! Clock of a rollout: counts of physics steps, control intervals and frames.

/// Time between two updates of the servo targets, s.
const CONTROL_INTERVAL: f64 = 0.008;

/// Counts steps and frames.
#[derive(Debug)]
pub(super) struct Clock {
    /// Time between frames, s.
    pub interval: f64,
    /// Physics steps between frames.
    pub steps_per_frame: usize,
    /// Time of a physics step, s.
    timestep: f64,
    steps_per_control: usize,
    /// Physics steps since the start. Control depends on this count alone, so that the frame rate does not affect it.
    steps: usize,
    n_frames: usize,
    next_frame: usize,
}

impl Clock {
    /// Creates a clock for an episode of `duration`, s, at `rate` frames per second.
    pub fn new(duration: f64, rate: f64, timestep: f64, steps_per_frame: usize) -> Self {
        Self {
            interval: 1.0 / rate,
            steps_per_frame,
            timestep,
            steps_per_control: (CONTROL_INTERVAL / timestep).round().max(1.0) as usize,
            steps: 0,
            n_frames: (duration * rate).floor() as usize + 1,
            next_frame: 0,
        }
    }

    /// Returns the number of frames of the whole episode.
    pub fn n_frames(&self) -> usize {
        self.n_frames
    }

    /// Returns the index of the next frame; `None` at the end.
    pub fn next_frame(&self) -> Option<usize> {
        (self.next_frame < self.n_frames).then_some(self.next_frame)
    }

    /// Returns the planned time of frame `index`, s.
    pub fn time_of(&self, index: usize) -> f64 {
        index as f64 * self.interval
    }

    /// Counts a frame.
    pub fn count_frame(&mut self) {
        self.next_frame += 1;
    }

    /// Ends the episode: there is no next frame.
    pub fn end(&mut self) {
        self.next_frame = self.n_frames;
    }

    /// Counts a physics step.
    pub fn count_step(&mut self) {
        self.steps += 1;
    }

    /// Returns the time until the next servo update, s, if one is due now.
    pub fn due_control(&self) -> Option<f64> {
        self.steps.is_multiple_of(self.steps_per_control).then_some(self.steps_per_control as f64 * self.timestep)
    }
}
