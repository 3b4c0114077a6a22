//! The OpenGL renderer that pictures come from.

/// The renderer's name, asked in a second process: a broken OpenGL ends or hangs the process that opens it.
///
/// # Errors
/// If no context opens; the error says what the engine or the system said.
#[cfg(feature = "sim")]
pub fn renderer() -> anyhow::Result<String> {
    use std::process::{Command, Stdio};
    use std::time::{Duration, Instant};

    const PATIENCE: Duration = Duration::from_secs(30);
    let mut child = Command::new(std::env::current_exe()?)
        .args(["doctor", "--probe-gl"])
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        // The engine leaves a log file in the current folder when it fails.
        .current_dir(std::env::temp_dir())
        .spawn()?;
    let started = Instant::now();
    while child.try_wait()?.is_none() {
        if started.elapsed() > PATIENCE {
            child.kill()?;
            child.wait()?;
            anyhow::bail!("OpenGL did not answer within {} s", PATIENCE.as_secs());
        }
        std::thread::sleep(Duration::from_millis(10));
    }
    let output = child.wait_with_output()?;
    let said = String::from_utf8_lossy(if output.status.success() { &output.stdout } else { &output.stderr });
    let said = said.lines().map(str::trim).filter(|line| !line.is_empty()).collect::<Vec<_>>().join("; ");
    match (output.status.success(), said.is_empty()) {
        (true, _) => Ok(said),
        (false, true) => anyhow::bail!("OpenGL ended the process ({})", output.status),
        (false, false) => anyhow::bail!("{}", said.trim_start_matches("egotac: ")),
    }
}

/// The name of this process's OpenGL renderer.
///
/// # Errors
/// If no context opens, or the build has no simulator.
#[cfg(not(feature = "sim"))]
pub fn renderer_here() -> anyhow::Result<String> {
    Err(crate::cli::feature_off("doctor --probe-gl", "sim"))
}

/// The name of this process's OpenGL renderer, from a context that is opened as the simulator opens it.
///
/// # Errors
/// If no context opens.
#[cfg(feature = "sim")]
#[allow(unsafe_code, reason = "OpenGL has no safe way to ask for its name; the two calls are explained below")]
pub fn renderer_here() -> anyhow::Result<String> {
    use std::ffi::{CStr, c_char, c_void};

    use anyhow::{Context as _, anyhow};
    use mujoco_rs::prelude::*;
    use mujoco_rs::renderer::MjRenderer;

    type GetProcAddress = unsafe extern "C" fn(*const c_char) -> *const c_void;
    type GetString = unsafe extern "C" fn(u32) -> *const c_char;
    const GL_RENDERER: u32 = 0x1F01;

    let model = MjModel::from_xml_string("<mujoco><worldbody/></mujoco>")?;
    let renderer = MjRenderer::builder().width(16).height(16).build(&model).context("no OpenGL context")?;
    // SAFETY: libEGL is loaded already, by the context above, and its initialisers have run.
    let egl = unsafe { libloading::Library::new("libEGL.so.1") }.context("libEGL.so.1")?;
    // SAFETY: the names and types are those of the EGL 1.5 and OpenGL 1.0 specifications. glGetString is called on the
    // thread whose context was made current above and still lives; it returns null or a static string.
    let name = unsafe {
        let get_proc_address = egl.get::<GetProcAddress>(b"eglGetProcAddress\0")?;
        let address = get_proc_address(c"glGetString".as_ptr());
        if address.is_null() {
            return Err(anyhow!("EGL does not know glGetString"));
        }
        let get_string = std::mem::transmute::<*const c_void, GetString>(address);
        let name = get_string(GL_RENDERER);
        if name.is_null() {
            return Err(anyhow!("OpenGL does not say its name"));
        }
        CStr::from_ptr(name).to_string_lossy().into_owned()
    };
    drop(renderer);
    Ok(name)
}
