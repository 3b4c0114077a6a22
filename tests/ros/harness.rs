#![allow(dead_code)] // Each test file that includes this module uses a part of it.
//! Starts the nodes' programs and rclpy peers in their own ROS domain and namespace, and always ends them.

use std::fs::File;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Duration, Instant};

use candle_core::{Device, Tensor};
use candle_nn::VarMap;
use egotac::model::{Checkpoint, Config, EgoTac, Metadata, init};
use egotac::node::own_domain::OwnDomain;
use tempfile::TempDir;

/// Time after which a program counts as hung: longer than that of a condition in peer.py. A passing test never waits for it.
const TIMEOUT: Duration = Duration::from_secs(300);

/// ROS domain, namespace and temporary folder of one test.
pub struct Session {
    domain: OwnDomain,
    namespace: String,
    folder: TempDir,
    started: AtomicU32,
}

impl Session {
    pub fn new() -> Self {
        static COUNT: AtomicU32 = AtomicU32::new(0);
        let (process, count) = (std::process::id(), COUNT.fetch_add(1, Ordering::SeqCst));
        Self {
            domain: OwnDomain::take(),
            namespace: format!("/test_{process}_{count}"),
            folder: TempDir::new().unwrap(),
            started: AtomicU32::new(0),
        }
    }

    /// Returns the namespace of the nodes, for instance `/test_7_0`.
    pub fn namespace(&self) -> &str {
        &self.namespace
    }

    /// Returns a path in the temporary folder of this test.
    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Writes a checkpoint with random weights, so that its output depends on each pixel of the image.
    pub fn checkpoint(&self, config: &Config) -> PathBuf {
        let path = self.path("model.safetensors");
        let vars = VarMap::new();
        EgoTac::new(config, init::var_builder(&vars, 1, &Device::Cpu)).unwrap();
        for var in vars.all_vars() {
            var.set(&Tensor::randn(0f32, 0.2, var.shape(), &Device::Cpu).unwrap()).unwrap();
        }
        Checkpoint::save(&path, config, &Metadata::new("random", 2.0, 0.04), &vars).unwrap();
        path
    }

    /// Starts a node's program; `ros_args` follow `--ros-args`.
    pub fn node(&self, program: &str, ros_args: &[&str]) -> Running {
        self.spawn(self.command(program, ros_args), program)
    }

    /// As [`Self::node`], on one thread. The small networks of tests need no second one, and a training whose threads wait for each other
    /// takes two to three times as long on a machine that is busy with other tests.
    pub fn node_on_one_thread(&self, program: &str, ros_args: &[&str]) -> Running {
        let mut command = self.command(program, ros_args);
        command.env("RAYON_NUM_THREADS", "1");
        self.spawn(command, program)
    }

    fn command(&self, program: &str, ros_args: &[&str]) -> Command {
        let mut command = Command::new(program);
        command.arg("--ros-args").arg("-r").arg(format!("__ns:={}", self.namespace)).args(ros_args);
        command
    }

    /// Starts `tests/ros/<script>` under Python.
    pub fn peer(&self, script: &str, arguments: &[&str]) -> Running {
        let mut command = python();
        command.arg(Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/ros").join(script)).args(arguments);
        command.env("EGOTAC_TEST_NAMESPACE", &self.namespace);
        self.spawn(command, script)
    }

    /// Runs a peer and expects exit status 0.
    pub fn check(&self, script: &str, arguments: &[&str]) {
        let mut peer = self.peer(script, arguments);
        let status = peer.wait();
        assert!(status.success(), "{script} {arguments:?}: {status}\n{}", peer.output());
    }

    /// Starts any program in this ROS domain.
    pub fn spawn(&self, mut command: Command, name: &str) -> Running {
        let count = self.started.fetch_add(1, Ordering::SeqCst);
        let stem = Path::new(name).file_stem().unwrap().to_string_lossy().into_owned();
        let log = self.path(&format!("{count}_{stem}.log"));
        let output = File::create(&log).unwrap();
        command.env("ROS_DOMAIN_ID", self.domain.id().to_string());
        command.env("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST");
        command.env("ROS_LOG_DIR", self.folder.path());
        command.env("PYTHONDONTWRITEBYTECODE", "1");
        command.stdin(Stdio::null()).stdout(output.try_clone().unwrap()).stderr(output);
        let child = command.spawn().unwrap_or_else(|error| panic!("{name}: {error}"));
        Running { child, log }
    }
}

/// Returns the Python interpreter of `make setup`, which has rclpy and our messages.
pub fn python() -> Command {
    Command::new(std::env::var("EGOTAC_PYTHON").expect("EGOTAC_PYTHON is not set: source env.sh first"))
}

/// Running program; killed when the test ends, also by a panic.
pub struct Running {
    child: Child,
    log: PathBuf,
}

impl Running {
    /// Sends `INT`, `TERM` or another signal.
    pub fn signal(&self, signal: &str) {
        let status = Command::new("kill").arg(format!("-{signal}")).arg(self.child.id().to_string()).status();
        assert!(status.unwrap().success());
    }

    /// Returns the id of the process.
    pub fn id(&self) -> u32 {
        self.child.id()
    }

    /// Waits for the end of the program.
    pub fn wait(&mut self) -> ExitStatus {
        let started = Instant::now();
        loop {
            if let Some(status) = self.child.try_wait().unwrap() {
                return status;
            }
            assert!(started.elapsed() < TIMEOUT, "{} does not end\n{}", self.log.display(), self.output());
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    /// Sends a signal and expects exit status 0.
    pub fn ends_cleanly(&mut self, signal: &str) {
        self.signal(signal);
        let status = self.wait();
        assert_eq!(status.code(), Some(0), "after SIG{signal}: {status}\n{}", self.output());
    }

    /// Returns true if the program still runs.
    pub fn is_running(&mut self) -> bool {
        self.child.try_wait().unwrap().is_none()
    }

    /// Returns the output so far.
    pub fn output(&self) -> String {
        std::fs::read_to_string(&self.log).unwrap_or_default()
    }

    /// Waits until the program prints `text`.
    pub fn prints(&mut self, text: &str) {
        let started = Instant::now();
        while !self.output().contains(text) {
            assert!(self.is_running(), "ended without printing {text:?}\n{}", self.output());
            assert!(started.elapsed() < TIMEOUT, "does not print {text:?}\n{}", self.output());
            std::thread::sleep(Duration::from_millis(20));
        }
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
        if std::thread::panicking() {
            println!("--- {}\n{}", self.log.display(), self.output());
        }
    }
}
