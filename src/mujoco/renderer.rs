//! Offscreen rendering of a world through EGL.

use std::sync::atomic::{AtomicUsize, Ordering};

use ::image::RgbImage;
use mujoco_rs::prelude::*;
use mujoco_rs::renderer::MjRenderer;

use super::camera::FreeCamera;
use super::world::World;
use crate::error::{Error, Result};

static CONTEXTS: AtomicUsize = AtomicUsize::new(0);

/// Renders one camera of a world without a display.
///
/// Owns an OpenGL context, which belongs to one thread: create one renderer per thread and drop it on that thread.
#[derive(Debug)]
pub struct Renderer {
    inner: MjRenderer,
    width: u32,
    height: u32,
}

impl Renderer {
    /// Opens an OpenGL context for `camera` of `world`, `width` x `height` pixels; `depth` records distances too.
    ///
    /// # Errors
    /// If the size is zero or above the model's offscreen buffer, or there is no working EGL.
    pub fn new(world: &World, camera: usize, width: u32, height: u32, depth: bool) -> Result<Self> {
        Self::open(world, MjvCamera::new_fixed(camera), width, height, depth)
    }

    /// Opens an OpenGL context for a free camera, with a picture of `size` (width, height) pixels; see [`Self::new`].
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn free(world: &World, camera: &FreeCamera, size: (u32, u32), depth: bool) -> Result<Self> {
        let mut engine_camera = MjvCamera::new_free(world.model());
        // The engine's azimuth and elevation are the angles of the viewing direction.
        let forward = camera.forward();
        engine_camera.lookat = camera.point.to_array();
        engine_camera.distance = camera.distance;
        engine_camera.azimuth = forward.y.atan2(forward.x).to_degrees();
        engine_camera.elevation = forward.z.clamp(-1.0, 1.0).asin().to_degrees();
        Self::open(world, engine_camera, size.0, size.1, depth)
    }

    fn open(world: &World, camera: MjvCamera, width: u32, height: u32, depth: bool) -> Result<Self> {
        let global = &world.model().vis().global;
        for (name, value, most) in [("width", width, global.offwidth), ("height", height, global.offheight)] {
            if value == 0 || i64::from(value) > i64::from(most) {
                return Err(Error::value(format!("picture {name}"), format!("1 to {most} pixels"), value));
            }
        }
        let inner = MjRenderer::builder()
            .width(width)
            .height(height)
            .camera(camera)
            .depth(depth)
            .build(world.model())
            .map_err(|e| Error::Engine(format!("no OpenGL context for rendering without a display: {e}")))?;
        CONTEXTS.fetch_add(1, Ordering::Relaxed);
        Ok(Self { inner, width, height })
    }

    /// Returns the number of OpenGL contexts that this process has opened.
    pub fn contexts_opened() -> usize {
        CONTEXTS.load(Ordering::Relaxed)
    }

    /// Returns the distance of each pixel of the last picture from the camera plane, m, row by row; empty if the
    /// renderer was opened without depth.
    pub fn depth(&self) -> Vec<f32> {
        self.inner.depth_flat().map(<[f32]>::to_vec).unwrap_or_default()
    }

    /// Draws the world in the state of its last [`World::forward`].
    ///
    /// # Errors
    /// If OpenGL fails.
    pub fn render(&mut self, world: &mut World) -> Result<RgbImage> {
        let failed = |e: RendererError| Error::Engine(format!("rendering failed: {e}"));
        self.inner.sync_data(world.data_mut()).map_err(failed)?;
        self.inner.render().map_err(failed)?;
        let pixels = self.inner.rgb_flat().map(<[u8]>::to_vec).unwrap_or_default();
        RgbImage::from_raw(self.width, self.height, pixels)
            .ok_or_else(|| Error::Engine("the renderer returned no picture".into()))
    }
}
