//! Limits on a child process: memory and time.

/// Largest address space of a child, bytes: limits of the readers at their defaults, and what they hold at once.
pub const MEMORY: u64 = 2 << 30;
/// Processor time of one input, s. Unlike wall time it does not depend on what else the machine does.
const PROCESSOR_SECONDS: i64 = 10;
/// Wall time of one input, s: an input that waits for something uses no processor time.
const WALL_SECONDS: u32 = 60;

/// Limits the memory of this process for good.
///
/// # Errors
/// If the system refuses.
#[allow(unsafe_code)]
pub fn limit_memory() -> anyhow::Result<()> {
    let limit = libc::rlimit { rlim_cur: MEMORY, rlim_max: MEMORY };
    let no_core = libc::rlimit { rlim_cur: 0, rlim_max: 0 };
    // SAFETY: `setrlimit` only reads the two structs, which outlive the calls.
    let failed = unsafe { libc::setrlimit(libc::RLIMIT_AS, &limit) | libc::setrlimit(libc::RLIMIT_CORE, &no_core) };
    match failed {
        0 => Ok(()),
        _ => Err(std::io::Error::last_os_error().into()),
    }
}

/// Starts the time of one input: the system ends the process by SIGPROF or SIGALRM when it is over.
#[allow(unsafe_code)]
pub fn start_time() {
    let zero = libc::timeval { tv_sec: 0, tv_usec: 0 };
    let time = libc::itimerval { it_interval: zero, it_value: libc::timeval { tv_sec: PROCESSOR_SECONDS, tv_usec: 0 } };
    // SAFETY: `setitimer` reads `time`, which outlives the call, and takes null for the old value; `alarm` has no pointer.
    // The signals keep their default action, which runs no code of this process.
    unsafe {
        libc::setitimer(libc::ITIMER_PROF, &time, std::ptr::null_mut());
        libc::alarm(WALL_SECONDS);
    }
}

/// Reason of an end by this signal.
pub fn reason(signal: i32) -> String {
    match signal {
        libc::SIGPROF => format!("hang: more than {PROCESSOR_SECONDS} s of processor time"),
        libc::SIGALRM => format!("hang: more than {WALL_SECONDS} s"),
        libc::SIGSEGV => "SIGSEGV".into(),
        libc::SIGABRT => "SIGABRT".into(),
        other => format!("signal {other}"),
    }
}
