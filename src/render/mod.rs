//! Pictures of hands and fields, rasterised on the CPU: identical on every machine, without a display.
//!
//! ```
//! use egotac::hand::{HandModel, HandParams, Side};
//! use egotac::render::{View, force_colors, hand_picture};
//!
//! let model = HandModel::builtin(Side::Right);
//! let mut force = vec![0.0; 778];
//! force[model.tip_vertices[1] as usize] = 2.0;
//! let posed = model.forward(&HandParams::default());
//! let picture = hand_picture(&model, &posed, &force_colors(&force, 2.0), View::Palmar, (160, 200));
//! assert_eq!(picture.dimensions(), (160, 200));
//! ```

pub mod color;
mod enlarged;
pub mod figure;
pub mod font;
mod hand;
pub mod heat;
mod names;
#[doc(hidden)]
pub mod plot;
mod raster;
mod smooth;

pub use color::{color_bar, force_color, force_colors, region_colors};
pub use hand::{View, hand_picture, pixels};
