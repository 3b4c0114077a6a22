//! Places of names beside points, so that none covers another one.

use super::font;

/// Space between a point and the nearest place of its name, pixels.
const GAP: i32 = 8;
/// Distance between rings of places around a point, pixels.
const RING: i32 = 9;
/// Rings that are tried.
const RINGS: i32 = 24;
/// First ring whose names are joined to their points.
const JOINED: i32 = 1;

/// Name of a point.
pub(super) struct Name<'a> {
    pub(super) text: &'a str,
    /// The point, pixels.
    pub(super) at: (i32, i32),
    /// Height of the text, pixels.
    pub(super) size: u32,
}

/// Place of a name.
#[derive(Debug, Clone, Copy)]
pub(super) struct Spot {
    /// Upper left corner of the text, pixels.
    pub(super) corner: (i32, i32),
    /// End of the line from the point to a text that stands apart from it.
    pub(super) leader: Option<(i32, i32)>,
}

/// Returns a place for each name inside `frame`, as near to its point as the boxes `taken` and the names before it leave room. Boxes are
/// left, upper, right, lower; pixels. A name for which no place is left stands above its point.
pub(super) fn place(names: &[Name], mut taken: Vec<[i32; 4]>, frame: [i32; 4]) -> Vec<Spot> {
    let mut spots = Vec::new();
    for name in names {
        let (spot, covered) = candidates(name)
            .find(|(_, covered)| is_inside(covered, &frame) && taken.iter().all(|other| is_apart(covered, other)))
            .unwrap_or_else(|| above(name));
        taken.push(covered);
        spots.push(spot);
    }
    spots
}

/// Returns the place above a point, and the box that its text covers.
fn above(name: &Name) -> (Spot, [i32; 4]) {
    let (width, height) = size(name);
    let corner = (name.at.0 - width / 2, name.at.1 - GAP - height);
    (Spot { corner, leader: None }, [corner.0, corner.1, corner.0 + width, corner.1 + height])
}

fn size(name: &Name) -> (i32, i32) {
    (font::width(name.text, f64::from(name.size)) as i32 + 2, name.size as i32 + 2)
}

/// Returns the places around a point from near to far, each with the box that the text covers there.
fn candidates(name: &Name) -> impl Iterator<Item = (Spot, [i32; 4])> {
    let ((x, y), (width, height)) = (name.at, size(name));
    (0..RINGS).flat_map(move |ring| {
        let gap = GAP + ring * RING;
        let slant = gap * 3 / 4;
        // Upper left corner, and the point of the text's box that is nearest to the point.
        let around = [
            ((x + gap, y - height / 2), (x + gap, y)),
            ((x - width / 2, y - gap - height), (x, y - gap)),
            ((x - width / 2, y + gap), (x, y + gap)),
            ((x - gap - width, y - height / 2), (x - gap, y)),
            ((x + slant, y - slant - height), (x + slant, y - slant)),
            ((x + slant, y + slant), (x + slant, y + slant)),
            ((x - slant - width, y - slant - height), (x - slant, y - slant)),
            ((x - slant - width, y + slant), (x - slant, y + slant)),
        ];
        around.into_iter().map(move |(corner, near)| {
            let spot = Spot { corner, leader: (ring >= JOINED).then_some(near) };
            (spot, [corner.0, corner.1, corner.0 + width, corner.1 + height])
        })
    })
}

fn is_apart(a: &[i32; 4], b: &[i32; 4]) -> bool {
    a[2] < b[0] || b[2] < a[0] || a[3] < b[1] || b[3] < a[1]
}

fn is_inside(a: &[i32; 4], frame: &[i32; 4]) -> bool {
    frame[0] <= a[0] && frame[1] <= a[1] && a[2] <= frame[2] && a[3] <= frame[3]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_near_points_cover_neither_each_other_nor_a_point() {
        let points = [(100, 200), (110, 203), (120, 198), (128, 201), (396, 203)];
        let names: Vec<Name> = points.iter().map(|at| Name { text: "egotac-pocket-8", at: *at, size: 15 }).collect();
        let dots: Vec<[i32; 4]> = points.iter().map(|(x, y)| [x - 5, y - 5, x + 5, y + 5]).collect();
        let spots = place(&names, dots.clone(), [0, 0, 400, 400]);
        let width = font::width("egotac-pocket-8", 15.0) as i32;
        let boxes: Vec<[i32; 4]> =
            spots.iter().map(|s| [s.corner.0, s.corner.1, s.corner.0 + width, s.corner.1 + 15]).collect();
        for (index, spot) in boxes.iter().enumerate() {
            assert!(boxes[..index].iter().all(|other| is_apart(spot, other)), "{boxes:?}");
            assert!(dots.iter().all(|dot| is_apart(spot, dot)), "{boxes:?}");
            assert!(is_inside(spot, &[0, 0, 400, 400]), "{boxes:?}");
        }
        // Far names are joined to their points.
        assert!(spots.iter().zip(&points).all(|(spot, (x, y))| {
            let (dx, dy) = (spot.corner.0 + width / 2 - x, spot.corner.1 + 7 - y);
            spot.leader.is_some() || (dx.abs() < width && dy.abs() < 40)
        }));
    }
}
