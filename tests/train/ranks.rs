//! Several ranks: the run of one process with the whole batch, whatever the number of ranks.

use std::collections::BTreeSet;
use std::path::Path;

use candle_core::{DType, Device, Tensor};
use candle_nn::VarMap;
use egotac::dataset::zarr::ZarrReader;
use egotac::image::{IMAGENET_MEAN, IMAGENET_STD, Preparation};
use egotac::model::{self, init};
use egotac::tactile::N_FIELD;
use egotac::train::batch::Collate;
use egotac::train::config::{AugmentConfig, LossWeights};
use egotac::train::data::Dataset;
use egotac::train::keypoints::{Heads, N_POINTS, Points, in_image};
use egotac::train::loss::{SupervisedCounts, Targets, objective, objective_of_share};
use egotac::train::ranks::{Communicator, DeviceSums, threads};
use egotac::train::sampler::{Clip, Pool, Sampler, Share};
use egotac::train::{Config, Control, Event, Outcome, Step, train_on};
use proptest::prelude::*;

use crate::stores;

/// Result of a run on each rank: outcome or error, and the steps that its observer was told of.
type OnRank = (Result<Option<Outcome>, String>, Vec<Step>);

/// Trains on `ranks` threads, whose configurations `of` gives; the observer of `stopping.0` stops the run after step `stopping.1`.
fn run(ranks: usize, of: impl Fn(usize) -> Config + Sync, resume: bool, stopping: (usize, usize)) -> Vec<OnRank> {
    run_by(ranks, |rank| rank, of, resume, stopping)
}

/// As [`run`], where `by` makes a communicator of each thread.
fn run_by<R: Communicator>(
    ranks: usize,
    by: impl Fn(threads::Thread) -> R + Sync,
    of: impl Fn(usize) -> Config + Sync,
    resume: bool,
    stopping: (usize, usize),
) -> Vec<OnRank> {
    let work = |rank: threads::Thread| {
        let rank = by(rank);
        let (mut steps, number) = (Vec::new(), rank.rank());
        let outcome = train_on(&rank, &of(number), resume, &Device::Cpu, &mut |event| match event {
            Event::Stepped(step) => {
                steps.push(step.clone());
                if stopping == (number, step.step) { Control::Stop } else { Control::Continue }
            }
            _ => Control::Continue,
        });
        (outcome.map_err(|error| error.to_string()), steps)
    };
    std::thread::scope(|scope| {
        let work = &work;
        let started: Vec<_> = threads::group(ranks).into_iter().map(|rank| scope.spawn(move || work(rank))).collect();
        started.into_iter().map(|thread| thread.join().unwrap()).collect()
    })
}

/// A rank that sums gradients as tensors, as ranks with GPUs do, but on the CPU.
struct ByTensor {
    rank: threads::Thread,
    /// False for a rank that can't.
    sums: bool,
}

impl DeviceSums for ByTensor {
    fn sum_tensors(&self, tensors: &[Tensor]) -> egotac::Result<Vec<Tensor>> {
        let sum = |tensor: &Tensor| {
            assert!(tensor.is_contiguous());
            let mut values = tensor.flatten_all()?.to_vec1()?;
            self.rank.sum_f32(&mut values)?;
            Ok(Tensor::from_vec(values, tensor.shape(), &Device::Cpu)?)
        };
        tensors.iter().map(sum).collect()
    }
}

impl Communicator for ByTensor {
    fn rank(&self) -> usize {
        self.rank.rank()
    }

    fn size(&self) -> usize {
        self.rank.size()
    }

    fn sum_f32(&self, _: &mut [f32]) -> egotac::Result<()> {
        panic!("gradients in host memory")
    }

    fn sum_f64(&self, values: &mut [f64]) -> egotac::Result<()> {
        self.rank.sum_f64(values)
    }

    fn broadcast(&self, values: &mut [f32]) -> egotac::Result<()> {
        self.rank.broadcast(values)
    }

    fn barrier(&self) -> egotac::Result<()> {
        self.rank.barrier()
    }

    fn sums_on(&self, device: &Device) -> Option<&dyn DeviceSums> {
        (self.sums && device.is_cpu()).then_some(self)
    }

    fn abort(&self, error: &dyn std::fmt::Display) {
        self.rank.abort(error);
    }
}

/// Quarters of the vertices whose force and contact are known, true force, predicted force.
type Row = (u8, u8, f32, f32);

const NEVER: (usize, usize) = (0, usize::MAX);

fn config(folder: &Path, out: &str, clips: usize, steps: usize) -> Config {
    serde_yaml::from_str(&stores::config(folder, out, clips, steps)).unwrap()
}

/// Checks that two runs took the same steps, and returns the largest relative difference of the losses.
fn compare(steps: &[Step], whole: &[Step]) -> f64 {
    assert_eq!(steps.len(), whole.len());
    let mut worst = 0f64;
    for (a, b) in steps.iter().zip(whole) {
        assert_eq!((a.step, a.windows, a.frames), (b.step, b.windows, b.frames));
        for (a, b) in a.losses.values().into_iter().zip(b.losses.values()) {
            worst = worst.max(f64::from((a - b).abs() / b.abs().max(1e-6)));
        }
    }
    worst
}

#[test]
fn ranks_take_the_steps_of_one_process_with_the_whole_batch() {
    let folder = tempfile::tempdir().unwrap();
    stores::write(folder.path());
    let at = |out: &str| folder.path().join(out).join("checkpoint.safetensors");
    let of = |out: &str, clips| config(folder.path(), out, clips, 9);
    let whole = run(1, |_| of("whole", 4), false, NEVER).remove(0);
    assert_eq!(whole.0.unwrap().unwrap().steps, 9);
    // Masked entries: the counts of the batches differ.
    let windows: BTreeSet<usize> = whole.1.iter().map(|step| step.windows).collect();
    assert!(windows.len() > 1, "{windows:?}");
    assert!(whole.1.iter().all(|step| step.exchange_bytes == 0) && whole.1.iter().any(|step| step.losses.active > 0.0));
    for (ranks, clips) in [(2, 2), (4, 1)] {
        let out = format!("ranks{ranks}");
        let results = run(ranks, |_| of(&out, clips), false, NEVER);
        for (rank, (outcome, steps)) in results.iter().enumerate() {
            assert_eq!(outcome.as_ref().unwrap().is_some(), rank == 0, "rank 0 alone has an outcome");
            let losses = compare(steps, &whole.1);
            assert!(losses < 1e-5, "{ranks} ranks: {losses} in the losses");
        }
        let (weights, name) = stores::difference(&at(&out), &at("whole"));
        assert!(weights < 1e-4, "{ranks} ranks: {weights} in {name}");
        assert_eq!(results[0].1[0].exchange_bytes, results[1].1[0].exchange_bytes);
        assert!(results[0].1[0].exchange_bytes > 4 * 1556 * 64);
    }
    // The comparison notices other batches.
    let other = run(2, |_| of("other", 1), false, NEVER);
    assert!(stores::difference(&at("other"), &at("whole")).0 > 1e-3);
    assert_ne!(other[0].1[0].windows, whole.1[0].windows);
}

#[test]
fn gradients_are_the_same_whether_summed_in_host_memory_or_as_tensors() {
    let folder = tempfile::tempdir().unwrap();
    stores::write(folder.path());
    // The last batch of an epoch has fewer than seven clips, so that some ranks have no gradient.
    for (ranks, clips) in [(2, 2), (7, 1)] {
        let of = |out: &str| config(folder.path(), out, clips, 6);
        let (host, tensors) = (format!("host{ranks}"), format!("tensors{ranks}"));
        let left = run(ranks, |_| of(&host), false, NEVER);
        let right = run_by(ranks, |rank| ByTensor { rank, sums: true }, |_| of(&tensors), false, NEVER);
        assert_eq!(compare(&right[0].1, &left[0].1), 0.0);
        // As tensors, no zeros are sent for variables of which no rank has a gradient.
        let [left, right] = [left, right].map(|results| results[0].1[0].exchange_bytes);
        assert!(right <= left && right > left / 10 * 9, "{right} of {left}");
        let at = |out: &str| folder.path().join(out).join("checkpoint.safetensors");
        assert_eq!(stores::difference(&at(&host), &at(&tensors)).0, 0.0);
    }
}

#[test]
fn a_run_resumes_on_another_number_of_ranks() {
    let folder = tempfile::tempdir().unwrap();
    stores::write(folder.path());
    let at = |out: &str| folder.path().join(out).join("checkpoint.safetensors");
    let of = |out: &str| config(folder.path(), out, 2, 8);
    let whole = run(2, |_| of("whole"), false, NEVER);
    // Rank 1 alone is asked to stop.
    let first = run(2, |_| of("parts"), false, (1, 3));
    assert!(first.iter().all(|(_, steps)| steps.len() == 3));
    // 3 ranks don't divide the 4 clips of a batch.
    let second = run(3, |_| of("parts"), true, (0, 5));
    assert!(second.iter().all(|(_, steps)| steps.len() == 2));
    let third = run(1, |_| of("parts"), true, NEVER);
    let steps: Vec<Step> = [&first, &second, &third].into_iter().flat_map(|part| part[0].1.clone()).collect();
    assert!(compare(&steps, &whole[0].1) < 1e-5);
    let (weights, name) = stores::difference(&at("parts"), &at("whole"));
    assert!(weights < 1e-4, "{weights} in {name}");
    let log = std::fs::read_to_string(folder.path().join("parts/log.csv")).unwrap();
    let steps: Vec<&str> = log.lines().skip(1).map(|line| line.split(',').next().unwrap()).collect();
    assert_eq!(steps, ["1", "2", "3", "4", "5", "6", "7", "8"]);
}

#[test]
fn all_ranks_fail_when_one_does() {
    let folder = tempfile::tempdir().unwrap();
    stores::write(folder.path());
    let other_seed = |rank| Config { seed: 5 + rank as u64, ..config(folder.path(), "seeds", 2, 4) };
    let told = run(2, other_seed, false, NEVER).into_iter().map(|(outcome, _)| outcome.unwrap_err());
    assert!(told.into_iter().all(|error| error.contains("rank 1")));
    let other_device = |rank: threads::Thread| ByTensor { sums: rank.rank() == 0, rank };
    let told = run_by(2, other_device, |_| config(folder.path(), "devices", 2, 4), false, NEVER);
    assert!(told[1].0.as_ref().unwrap_err().contains("devices (CPU or GPU) of rank 1"), "{told:?}");
    let other_data = |rank| {
        let config = config(folder.path(), "data", 2, 4);
        match rank {
            0 => config,
            // The file is there on rank 0 only.
            _ => Config { init: Some(folder.path().join("absent")), ..config },
        }
    };
    let results = run(3, other_data, false, NEVER);
    let told: Vec<String> = results.into_iter().map(|(outcome, _)| outcome.unwrap_err()).collect();
    assert!(told[1..].iter().any(|error| error.contains("absent")), "{told:?}");
    assert!(told[0].contains("expected one that trains on"), "{told:?}");
}

#[test]
fn the_parts_of_a_batch_look_as_they_do_in_the_whole() {
    let folder = tempfile::tempdir().unwrap();
    stores::write(folder.path());
    let preparation = Preparation {
        side: 16,
        resize: Default::default(),
        filter: Default::default(),
        mean: IMAGENET_MEAN,
        std: IMAGENET_STD,
    };
    let reader = ZarrReader::open(&folder.path().join("a.zarr")).unwrap();
    let data = Dataset::new(vec![reader], preparation, true).unwrap();
    let augment = AugmentConfig::default();
    let collate = Collate { horizon: 3, predict: 1, frame_dt: 0.12, force_scale: 1.0, augment, seed: 9 };
    let clip = |start: usize, windows: usize| Clip {
        store: 0,
        episode: 0..23,
        newest: (start..start + 3 * windows).step_by(3).collect(),
    };
    let clips = [clip(0, 2), clip(5, 3), clip(1, 1), clip(7, 2), clip(2, 4)];
    // Batches of one clip at its place, from as many ranks as there are clips.
    let single: Vec<_> = (0..clips.len())
        .map(|rank| data.batch_of(Share { rank, ranks: clips.len() }, &collate, 3, &clips).unwrap())
        .collect();
    for ranks in [1, 2, 3, 7] {
        for rank in 0..ranks {
            let part = data.batch_of(Share { rank, ranks }, &collate, 3, &clips).unwrap();
            let joined: Vec<f32> =
                (rank..clips.len()).step_by(ranks).flat_map(|at| single[at].frames.clone()).collect();
            assert_eq!(part.frames, joined, "rank {rank} of {ranks}");
            let masks: Vec<f32> =
                (rank..clips.len()).step_by(ranks).flat_map(|at| single[at].mask_force.clone()).collect();
            assert_eq!(part.mask_force, masks);
        }
    }
    assert_eq!(
        data.batch(&collate, 3, &clips).unwrap().frames,
        single.iter().flat_map(|b| b.frames.clone()).collect::<Vec<_>>()
    );
    // The augmentation depends on the place of the clip.
    let alone = data.batch(&collate, 3, &clips[1..2]).unwrap();
    assert_ne!(alone.frames, single[1].frames);
}

proptest! {
    #[test]
    fn ranks_share_each_batch_without_overlap(
        seed in any::<u64>(),
        ranks in 1usize..9,
        clips in 1usize..12,
        frames in 1usize..80,
    ) {
        let pools = vec![Pool::whole(vec![(0, 0..frames, 2), (1, 3..3 + frames / 2, 1)])];
        let batches = || Sampler::new(pools.clone(), 4, clips, seed).take(12);
        for (batch, again) in batches().zip(batches()) {
            prop_assert_eq!(&batch, &again);
            let parts: Vec<Vec<(usize, Clip)>> = (0..ranks)
                .map(|rank| Share { rank, ranks }.of(&batch).map(|(at, clip)| (at, clip.clone())).collect())
                .collect();
            let sizes: Vec<usize> = parts.iter().map(Vec::len).collect();
            prop_assert!(sizes.iter().max().unwrap() - sizes.iter().min().unwrap() <= 1);
            let mut joined: Vec<(usize, Clip)> = parts.into_iter().flatten().collect();
            joined.sort_by_key(|(at, _)| *at);
            prop_assert_eq!(joined, batch.into_iter().enumerate().collect::<Vec<_>>());
        }
    }

    #[test]
    fn the_objectives_of_the_parts_add_up_to_that_of_the_whole(
        rows in prop::collection::vec((0u8..4, 0u8..4, 0.0f32..2.0, -3.0f32..3.0), 2..6),
        cut in 0.0f64..1.0,
    ) {
        // Each row knows the vertices below a quarter of its numbers.
        let n = rows.len();
        let tensor = |of: &dyn Fn(&Row, usize) -> f32| {
            let values: Vec<f32> = rows.iter().flat_map(|row| (0..N_FIELD).map(move |v| of(row, v))).collect();
            Tensor::from_vec(values, (n, 1, N_FIELD), &Device::Cpu).unwrap()
        };
        let below = |quarters: u8, v: usize| f32::from(u8::from(v < usize::from(quarters) * N_FIELD / 4));
        let truth = Targets {
            force: tensor(&|row, v| if v % 3 == 0 { row.2 } else { 0.0 }),
            contact: tensor(&|row, v| f32::from(u8::from(v % 3 == 0 && row.2 > 0.05))),
            mask_force: tensor(&|row, v| below(row.0, v)),
            mask_contact: tensor(&|row, v| below(row.1, v)),
        };
        let (force, logits) = (tensor(&|row, v| row.3 + v as f32 * 1e-4), tensor(&|row, v| row.3 - v as f32 * 1e-3));
        let weights = LossWeights::default();
        let terms = |o: egotac::train::loss::Objective| {
            [o.total, o.force, o.contact, o.active, o.consistency].map(|t| f64::from(t.to_scalar::<f32>().unwrap()))
        };
        let whole = terms(objective(&force, &logits, &truth, 0.5, &weights).unwrap());
        let rows_of = |range: std::ops::Range<usize>| {
            let part = |t: &Tensor| t.narrow(0, range.start, range.len()).unwrap();
            let Targets { force, contact, mask_force, mask_contact } = &truth;
            let [force, contact, mask_force, mask_contact] = [force, contact, mask_force, mask_contact].map(part);
            Targets { force, contact, mask_force, mask_contact }
        };
        let flat = |t: &Tensor| t.flatten_all().unwrap().to_vec1::<f32>().unwrap();
        let counts = |t: &Targets| SupervisedCounts::of(&flat(&t.force), &flat(&t.mask_force), &flat(&t.mask_contact), 0.5).values();
        let at = 1 + (cut * (n - 1) as f64) as usize % (n - 1);
        let parts = [0..at, at..n];
        // Counts of the parts, added as the ranks do.
        let mut sum = [0.0; 5];
        for part in &parts {
            sum.iter_mut().zip(counts(&rows_of(part.clone()))).for_each(|(sum, count)| *sum += count);
        }
        let mut added = [0.0; 5];
        for part in parts {
            let cut = |t: &Tensor| t.narrow(0, part.start, part.len()).unwrap();
            let counts = SupervisedCounts::from_values(sum);
            let o = objective_of_share(&cut(&force), &cut(&logits), &rows_of(part.clone()), 0.5, &weights, &counts);
            added.iter_mut().zip(terms(o.unwrap())).for_each(|(sum, term)| *sum += term);
        }
        for (added, whole) in added.into_iter().zip(whole) {
            prop_assert!((added - whole).abs() <= 1e-5 * whole.abs().max(1e-3), "{} {}", added, whole);
        }
    }
}

#[test]
fn the_keypoint_losses_of_the_parts_add_up_to_that_of_the_whole() {
    let geometry = model::Config::toy();
    let heads = Heads::new(&geometry, init::var_builder(&VarMap::new(), 1, &Device::Cpu)).unwrap();
    let random =
        |shape: &[usize]| Tensor::randn(0f32, 1f32, shape, &Device::Cpu).unwrap().to_dtype(DType::F32).unwrap();
    let (tokens, z) = (random(&[5, geometry.tokens(), geometry.vision_width]), random(&[5, geometry.width]));
    // Frame i knows 9 i points.
    let frame = |i: usize| -> Points {
        std::array::from_fn(|k| if k < 9 * i { [0.02 * k as f32, 0.9 - 0.01 * k as f32] } else { [f32::NAN; 2] })
    };
    let points: Vec<Points> = (0..5).map(frame).collect();
    const { assert!(9 * 4 <= N_POINTS) };
    let counts = SupervisedCounts {
        points: in_image(&points) as f64,
        newest_points: in_image(&points) as f64,
        ..SupervisedCounts::default()
    };
    let loss = |range: std::ops::Range<usize>| {
        let cut = |t: &Tensor| t.narrow(0, range.start, range.len()).unwrap();
        let points = &points[range.clone()];
        let loss = heads.loss(&cut(&tokens), points, &cut(&z), points, &counts).unwrap();
        [loss.total, loss.patch, loss.cls, loss.scene].map(|t| t.to_scalar::<f32>().unwrap())
    };
    let (whole, first, second) = (loss(0..5), loss(0..3), loss(3..5));
    for i in 0..4 {
        assert!((first[i] + second[i] - whole[i]).abs() < 1e-5 * whole[i], "{first:?} {second:?} {whole:?}");
    }
    assert!(first[1] > 0.0 && second[1] > first[1]);
}

#[test]
#[cfg(not(feature = "mpi"))]
fn a_program_without_mpi_refuses_to_be_one_of_several_ranks() {
    let folder = tempfile::tempdir().unwrap();
    stores::write(folder.path());
    let file = folder.path().join("a.yaml");
    std::fs::write(&file, stores::config(folder.path(), "out", 2, 1)).unwrap();
    let mut command = std::process::Command::new(env!("CARGO_BIN_EXE_egotac"));
    command.args(["train", "--config"]).arg(&file).env("OMPI_COMM_WORLD_SIZE", "2");
    let output = command.output().unwrap();
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(!output.status.success() && said.contains("2 processes") && said.contains("--features mpi"), "{said}");
    assert!(!folder.path().join("out").exists());
}
