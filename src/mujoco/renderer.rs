//! Pictures of a world without a display.

use std::sync::atomic::{AtomicUsize, Ordering};

use ::image::RgbImage;
use mujoco_rs::prelude::*;
use mujoco_rs::renderer::MjRenderer;

use super::view::View;
use super::world::World;
use crate::error::{Error, Result};

static CONTEXTS: AtomicUsize = AtomicUsize::new(0);

/// Renders one camera of a world through EGL.
///
/// It owns an OpenGL context, which belongs to one thread: make one renderer per thread and drop it there.
#[derive(Debug)]
pub struct Renderer {
    inner: MjRenderer,
    width: u32,
    height: u32,
}

impl Renderer {
    /// Opens an OpenGL context for `camera` of `world`, `width` x `height` pixels, with distances where `depth` says so.
    ///
    /// # Errors
    /// If the size is zero or above the model's offscreen buffer, or there is no working EGL.
    pub fn new(world: &World, camera: usize, width: u32, height: u32, depth: bool) -> Result<Self> {
        Self::open(world, MjvCamera::new_fixed(camera), width, height, depth)
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

    /// Likewise, from a point of view.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub(super) fn around(world: &World, view: &View, (width, height): (u32, u32), depth: bool) -> Result<Self> {
        let mut camera = MjvCamera::new_free(world.model());
        // The camera's angles are those of the way it looks.
        let look = -view.toward.normalize_or_zero();
        camera.lookat = view.point.to_array();
        camera.distance = view.distance;
        camera.azimuth = look.y.atan2(look.x).to_degrees();
        camera.elevation = look.z.clamp(-1.0, 1.0).asin().to_degrees();
        Self::open(world, camera, width, height, depth)
    }

    /// OpenGL contexts that this process has opened so far.
    pub fn contexts_opened() -> usize {
        CONTEXTS.load(Ordering::Relaxed)
    }

    /// Distance from the camera's plane of each pixel of the last picture, m, row by row; empty unless it was asked for.
    pub fn depth(&self) -> Vec<f32> {
        self.inner.depth_flat().map(<[f32]>::to_vec).unwrap_or_default()
    }

    /// Draws the world as its last `forward` left it.
    ///
    /// # Errors
    /// If OpenGL fails.
    pub fn render(&mut self, world: &mut World) -> Result<RgbImage> {
        let failed = |e: RendererError| Error::Engine(format!("rendering failed: {e}"));
        self.inner.sync_data(world.data_mut()).map_err(failed)?;
        self.inner.render().map_err(failed)?;
        let pixels = self.inner.rgb_flat().map(<[u8]>::to_vec).unwrap_or_default();
        RgbImage::from_raw(self.width, self.height, pixels)
            .ok_or_else(|| Error::Engine("the renderer gave no picture".into()))
    }
}
