# Thin names for scripts/ and cargo.

.PHONY: help setup demo demo-retarget test doctor lint miri bench bench-tables fuzz build-times check-cuda check-gpu check-mpi check-order check-rerun wheel dist docs

help:
	@echo 'make setup       what this machine lacks: Python environment, ROS 2, messages, MuJoCo; writes env.sh'
	@echo 'make demo        the main job for 15 seconds: simulator, predictor, verifier; results in out/demo/'
	@echo 'make demo-retarget  a simulated hand grasps a mug, a robot hand follows; picture in out/demo-retarget/'
	@echo 'make test        everything that CI runs'
	@echo 'make wheel       the Python package, in target/wheels/ (pip install it anywhere; needs no ROS)'
	@echo 'make docs        the documentation as a book, in out/book/ (fetches mdBook)'
	@echo 'make doctor      what is missing on this machine, and how to fix it'
	@echo 'make lint        formatting, clippy for each feature set, docs, shell scripts, licences of crates, unsafe code'
	@echo 'make miri        the unsafe code of the kernels, interpreted (fetches a nightly toolchain)'
	@echo 'make dist        an archive of programs, messages and models that runs elsewhere (out/dist/)'
	@echo 'make bench       what accuracy costs in simulation (results in out/bench/), criterion benchmarks'
	@echo 'make bench-tables  the tables of speed in docs/bench, measured anew in one sitting, beside other programs (45 minutes)'
	@echo 'make fuzz        crafted hostile files for every reader, an hour each (inputs that fail in out/fuzz/)'
	@echo 'make build-times the crates that a first build spends its time on'
	@echo 'make check-cuda  clippy and a build of the feature cuda, with a toolkit from Python wheels'
	@echo 'make check-gpu   tests on an NVIDIA GPU: operations, network, a stream, training'
	@echo 'make check-mpi   clippy, a build and tests of the feature mpi: training on several processes (installs Open MPI as root)'
	@echo 'make check-order all tests in random order, ten times: finds those that fail now and then'
	@echo 'make check-rerun clippy, a build and tests of the feature rerun: files and data for the viewer Rerun'

setup:
	@scripts/setup

demo:
	@scripts/demo

demo-retarget:
	@scripts/demo-retarget

test:
	@scripts/test

doctor:
	@scripts/doctor

lint:
	@scripts/lint

miri:
	@scripts/miri

bench:
	@scripts/bench

bench-tables:
	@scripts/bench-tables

fuzz:
	@scripts/fuzz --seconds 3600

build-times:
	@scripts/build-times

dist:
	@scripts/dist

check-cuda:
	@scripts/check-cuda

check-gpu:
	@scripts/check-gpu

check-mpi:
	@scripts/check-mpi

check-order:
	@scripts/check-order

check-rerun:
	@scripts/check-rerun

wheel:
	@scripts/wheel

docs:
	@scripts/docs
