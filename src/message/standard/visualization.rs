//! Shapes that RViz draws: `visualization_msgs`.

use super::common::{ColorRGBA, Duration, Header};
use super::geometry::{Point, Pose, Vector3};
use super::sensor::CompressedImage;
use crate::message::message;

message! {
    /// Coordinates in a texture, 0 to 1.
    #[derive(Copy, Default)]
    #[allow(missing_docs)]
    UVCoordinate = "visualization_msgs/msg/UVCoordinate" { u: f32, v: f32 }

    /// A mesh file within a message.
    #[derive(Default)]
    MeshFile = "visualization_msgs/msg/MeshFile" {
        /// Name of the file.
        filename: String,
        /// Content of the file.
        data: Vec<u8>,
    }

    /// A shape to display.
    #[derive(Default)]
    Marker = "visualization_msgs/msg/Marker" {
        /// Time, and coordinate frame of `pose`.
        header: Header,
        /// Namespace of `id`.
        ns: String,
        /// Name of the marker in its namespace.
        id: i32,
        /// Kind of shape: 11 = list of triangles.
        kind: i32,
        /// 0 = add or replace, 2 = delete, 3 = delete all.
        action: i32,
        /// Pose of the shape.
        pose: Pose,
        /// Size of the shape; 1 = as given.
        scale: Vector3,
        /// Colour of the whole shape.
        color: ColorRGBA,
        /// Time for which it is shown; 0 = until it is replaced.
        lifetime: Duration,
        /// True if the shape moves with its frame.
        frame_locked: bool,
        /// Points of lists, three per triangle, m.
        points: Vec<Point>,
        /// Colour of each point; empty = that of the shape.
        colors: Vec<ColorRGBA>,
        /// Texture's address.
        texture_resource: String,
        /// Texture.
        texture: CompressedImage,
        /// Texture coordinates of each point.
        uv_coordinates: Vec<UVCoordinate>,
        /// Text of a text marker.
        text: String,
        /// Mesh's address.
        mesh_resource: String,
        /// Mesh.
        mesh_file: MeshFile,
        /// True if the mesh's own materials are used.
        mesh_use_embedded_materials: bool,
    }

    /// Shapes to display.
    #[derive(Default)]
    MarkerArray = "visualization_msgs/msg/MarkerArray" {
        /// The shapes.
        markers: Vec<Marker>,
    }
}
