//! The program `egotac_trainer`.

use std::process::ExitCode;

// Training allocates and frees many large tensors per step, which mimalloc does faster than the system's allocator.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() -> ExitCode {
    egotac::node::trainer::main()
}
