//! Checks the OpenGL renderer of the simulator.

/// Returns the renderer's name from a child process, because a broken OpenGL can end or hang the process that opens it.
///
/// # Errors
/// If no context opens; the error holds the output of the child.
#[cfg(feature = "sim")]
pub fn renderer() -> anyhow::Result<String> {
    use std::process::{Command, Stdio};
    use std::time::{Duration, Instant};

    const TIMEOUT: Duration = Duration::from_secs(30);
    let mut child = Command::new(crate::host::program()?)
        .args(["doctor", "--probe-gl"])
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        // On failure the engine writes a log file into the working directory.
        .current_dir(std::env::temp_dir())
        .spawn()?;
    let started = Instant::now();
    while child.try_wait()?.is_none() {
        if started.elapsed() > TIMEOUT {
            child.kill()?;
            child.wait()?;
            anyhow::bail!("OpenGL did not respond within {} s", TIMEOUT.as_secs());
        }
        std::thread::sleep(Duration::from_millis(10));
    }
    let output = child.wait_with_output()?;
    let text = String::from_utf8_lossy(if output.status.success() { &output.stdout } else { &output.stderr });
    let text = text.lines().map(str::trim).filter(|line| !line.is_empty()).collect::<Vec<_>>().join("; ");
    match (output.status.success(), text.is_empty()) {
        (true, _) => Ok(text),
        (false, true) => anyhow::bail!("OpenGL ended the process ({})", output.status),
        (false, false) => anyhow::bail!("{}", text.trim_start_matches("egotac: ")),
    }
}

/// Fails, because this build has no simulator.
///
/// # Errors
/// Always.
#[cfg(not(feature = "sim"))]
pub fn renderer_here() -> anyhow::Result<String> {
    Err(crate::cli::feature_off("doctor --probe-gl", "sim"))
}

/// Returns the name of this process's OpenGL renderer, from a context that is opened as the simulator does.
///
/// # Errors
/// If no context opens.
#[cfg(feature = "sim")]
pub fn renderer_here() -> anyhow::Result<String> {
    use anyhow::Context as _;
    use mujoco_rs::prelude::*;
    use mujoco_rs::renderer::MjRenderer;

    let model = MjModel::from_xml_string("<mujoco><worldbody/></mujoco>")?;
    let renderer = MjRenderer::builder().width(16).height(16).build(&model).context("no OpenGL context")?;
    renderer_name(&renderer)
}

/// Asks OpenGL for the name of the renderer; the context of `_current` must be current on this thread.
///
/// # Errors
/// If EGL or OpenGL does not answer.
#[cfg(feature = "sim")]
#[allow(unsafe_code, reason = "OpenGL has no safe call that returns the name")]
fn renderer_name(_current: &mujoco_rs::renderer::MjRenderer) -> anyhow::Result<String> {
    use std::ffi::{CStr, c_char, c_void};

    use anyhow::{Context as _, anyhow};

    type GetProcAddress = unsafe extern "C" fn(*const c_char) -> *const c_void;
    type GetString = unsafe extern "C" fn(u32) -> *const c_char;
    const GL_RENDERER: u32 = 0x1F01;

    // SAFETY: loading a library is sound if its initialisers are. They have run already: the renderer, which is alive
    // while `_current` is borrowed, has loaded libEGL, so this call only returns another handle of it.
    let egl = unsafe { libloading::Library::new("libEGL.so.1") }.context("libEGL.so.1")?;
    // SAFETY: the symbols must have the declared types: names and types are those of the EGL 1.5 and OpenGL 1.0
    // specifications, which the driver implements. glGetString needs a current context: the only caller has just opened
    // `_current` on this thread, and the borrow keeps it alive. The result is null, which is checked, or a static
    // string.
    unsafe {
        let get_proc_address = egl.get::<GetProcAddress>(b"eglGetProcAddress\0")?;
        let address = get_proc_address(c"glGetString".as_ptr());
        if address.is_null() {
            return Err(anyhow!("EGL has no function glGetString"));
        }
        let get_string = std::mem::transmute::<*const c_void, GetString>(address);
        let name = get_string(GL_RENDERER);
        if name.is_null() {
            return Err(anyhow!("OpenGL returned no renderer name"));
        }
        Ok(CStr::from_ptr(name).to_string_lossy().into_owned())
    }
}
