//! Compiles the GPU's kernels to PTX, with the feature `cuda`.

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    println!("cargo::rerun-if-changed=src/ops/cuda/kernels.cu");
    #[cfg(feature = "cuda")]
    gpu();
}

#[cfg(feature = "cuda")]
fn gpu() {
    let out = std::path::PathBuf::from(std::env::var_os("OUT_DIR").expect("cargo sets OUT_DIR"));
    let built = cudaforge::KernelBuilder::new().source_dir("src/ops/cuda").arg("-std=c++17").arg("-O3").build_ptx();
    built.and_then(|ptx| ptx.write(out.join("ptx.rs"))).expect("compiling kernels.cu with nvcc");
}
