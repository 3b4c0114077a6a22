//! The program `egotac_simulator`.

use std::process::ExitCode;

fn main() -> ExitCode {
    map_large_blocks();
    egotac::node::simulator::main()
}

/// Makes the allocator map each block from 128 KiB by itself, so that it goes back to the system when it is freed. By default this size
/// grows with the blocks that are freed: those of each scene, picture and mesh would then leave gaps of many sizes behind, and memory
/// would rise by some megabytes an hour.
fn map_large_blocks() {
    // SAFETY: `mallopt` takes numbers alone, and no other thread runs yet.
    #[cfg(target_env = "gnu")]
    #[allow(unsafe_code)]
    unsafe {
        libc::mallopt(libc::M_MMAP_THRESHOLD, 128 * 1024);
    }
}
