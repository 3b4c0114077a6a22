//! A tree of boxes around items: finds the nearest item, and the items whose boxes meet a region.

use glam::Vec3;

/// Largest number of items in a leaf.
const LEAF: usize = 16;
/// Least number of items in a leaf of a tree that has several.
const LEAST: usize = LEAF / 2;
/// Largest depth: halving 2^32 items ends before it.
const DEPTH: usize = 64;

/// A binary tree of boxes; items are numbered from 0.
#[derive(Debug, Clone)]
pub(super) struct Tree {
    /// The root, then pairs of children.
    nodes: Vec<Node>,
    /// Items in the order of the leaves.
    items: Vec<u32>,
}

/// A box with either two children or items.
#[derive(Debug, Clone, Copy)]
struct Node {
    low: Vec3,
    /// First child, or first entry in `items`.
    first: u32,
    high: Vec3,
    /// Number of items; 0 = the node has children.
    count: u32,
}

impl Tree {
    /// Builds the tree of items with these boxes: lower and upper corners.
    pub(super) fn new(boxes: &[[Vec3; 2]]) -> Self {
        let mut items: Vec<u32> = (0..boxes.len() as u32).collect();
        let empty = Node { low: Vec3::INFINITY, high: Vec3::NEG_INFINITY, first: 0, count: 0 };
        let mut nodes = vec![empty];
        let mut open = vec![(0, 0, items.len())];
        while let Some((at, from, to)) = open.pop() {
            let here = &mut items[from..to];
            if here.len() <= LEAF {
                (nodes[at].first, nodes[at].count) = (from as u32, here.len() as u32);
                continue;
            }
            // Twice the middle of each box.
            let middle = |item: &u32| boxes[*item as usize][0] + boxes[*item as usize][1];
            let low = here.iter().map(middle).fold(Vec3::INFINITY, Vec3::min);
            let high = here.iter().map(middle).fold(Vec3::NEG_INFINITY, Vec3::max);
            let axis = (high - low).max_position();
            let half = here.len() / 2;
            here.select_nth_unstable_by(half, |a, b| middle(a)[axis].total_cmp(&middle(b)[axis]));
            nodes[at].first = nodes.len() as u32;
            open.push((nodes.len(), from, from + half));
            open.push((nodes.len() + 1, from + half, to));
            nodes.extend([empty; 2]);
        }
        let mut tree = Self { nodes, items };
        tree.refit(|item| boxes[item as usize]);
        tree
    }

    /// Returns the number of each leaf with its items; numbers are below [`Tree::n_leaves`], and some may be left out.
    pub(super) fn leaves(&self) -> impl Iterator<Item = (usize, &[u32])> {
        let leaves = self.nodes.iter().filter(|node| node.count > 0);
        leaves.map(|node| (node.first as usize / LEAST, &self.items[node.first as usize..][..node.count as usize]))
    }

    /// Returns a number above those of all leaves.
    pub(super) fn n_leaves(&self) -> usize {
        self.items.len() / LEAST + 1
    }

    /// Takes over the boxes of items that moved.
    pub(super) fn refit(&mut self, of: impl Fn(u32) -> [Vec3; 2]) {
        // Children come after their parents.
        for at in (0..self.nodes.len()).rev() {
            let Node { first, count, .. } = self.nodes[at];
            let (mut low, mut high) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
            if count > 0 {
                for item in &self.items[first as usize..(first + count) as usize] {
                    let [l, h] = of(*item);
                    (low, high) = (low.min(l), high.max(h));
                }
            } else if first > 0 {
                for child in &self.nodes[first as usize..first as usize + 2] {
                    (low, high) = (low.min(child.low), high.max(child.high));
                }
            }
            (self.nodes[at].low, self.nodes[at].high) = (low, high);
        }
    }

    /// Returns the item nearest to `point` and its squared distance, m², if that is below `most`. `leaf` returns a lower bound of the
    /// squared distances of a leaf's items, m². `square` returns the squared distance of an item, or any number above its second
    /// argument if the distance is above that.
    #[inline]
    pub(super) fn nearest(
        &self,
        point: Vec3,
        most: f64,
        leaf: impl Fn(usize) -> f64,
        square: impl Fn(u32, f64) -> f64,
    ) -> Option<(u32, f64)> {
        let gap = |at: usize| gap_squared(self.nodes[at].low, self.nodes[at].high, point);
        let (mut best, mut found) = (most, None);
        let mut open = [(0.0f32, 0u32); DEPTH];
        (open[0], open[1]) = ((gap(0), 0), (0.0, 0));
        let mut n_open = 1;
        while n_open > 0 {
            n_open -= 1;
            let (far, mut at) = open[n_open];
            // A gap is rounded to the precision of a box.
            if f64::from(far) > best {
                continue;
            }
            loop {
                let Node { first, count, .. } = self.nodes[at as usize];
                if count > 0 || first == 0 {
                    if count > 0 && leaf(first as usize / LEAST) > best {
                        break;
                    }
                    for item in &self.items[first as usize..(first + count) as usize] {
                        let square = square(*item, best);
                        if square < best {
                            (best, found) = (square, Some((*item, square)));
                        }
                    }
                    break;
                }
                let (left, right) = (gap(first as usize), gap(first as usize + 1));
                let [near, far] = if right < left {
                    [(right, first + 1), (left, first)]
                } else {
                    [(left, first), (right, first + 1)]
                };
                if f64::from(far.0) <= best {
                    open[n_open] = far;
                    n_open += 1;
                }
                if f64::from(near.0) > best {
                    break;
                }
                at = near.1;
            }
        }
        found
    }

    /// Gives `visit` the items of leaves whose boxes, lower and upper corner, meet a region, until it returns true; returns true if
    /// it did.
    #[inline]
    pub(super) fn any(&self, meets: impl Fn(Vec3, Vec3) -> bool, mut visit: impl FnMut(u32) -> bool) -> bool {
        let mut open = [0u32; DEPTH];
        let mut n_open = 1;
        while n_open > 0 {
            n_open -= 1;
            let Node { low, high, first, count } = self.nodes[open[n_open] as usize];
            if !meets(low, high) {
                continue;
            }
            if count > 0 || first == 0 {
                if self.items[first as usize..(first + count) as usize].iter().any(|item| visit(*item)) {
                    return true;
                }
                continue;
            }
            (open[n_open], open[n_open + 1]) = (first, first + 1);
            n_open += 2;
        }
        false
    }
}

/// Computes the squared distance of a point from a box, m².
#[inline]
pub(super) fn gap_squared(low: Vec3, high: Vec3, point: Vec3) -> f32 {
    (low - point).max(point - high).max(Vec3::ZERO).length_squared()
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn point() -> impl Strategy<Value = Vec3> {
        // Coarse numbers make equal points and boxes without an extent.
        prop::array::uniform3(-8i8..8).prop_map(|p| Vec3::from_array(p.map(f32::from)))
    }

    proptest! {
        #[test]
        fn the_nearest_item_and_the_items_in_a_region_are_those_of_a_full_search(
            points in prop::collection::vec(point(), 1..200), moved in prop::collection::vec(point(), 200), at in point(), most in 1f64..200.0,
        ) {
            let mut tree = Tree::new(&points.iter().map(|p| [*p; 2]).collect::<Vec<_>>());
            for points in [&points, &moved[..points.len()].to_vec()] {
                tree.refit(|item| [points[item as usize]; 2]);
                let square = |item: u32| f64::from(points[item as usize].distance_squared(at));
                let least = (0..points.len() as u32).map(square).fold(f64::INFINITY, f64::min);
                prop_assert_eq!(tree.nearest(at, most, |_| 0.0, |item, _| square(item)).map(|found| found.1), (least < most).then_some(least));
                let mut seen = Vec::new();
                tree.any(|low, high| gap_squared(low, high, at) <= 9.0, |item| { seen.push(item); false });
                for item in (0..points.len() as u32).filter(|item| square(*item) <= 9.0) {
                    prop_assert!(seen.contains(&item));
                }
                seen.sort_unstable();
                seen.dedup();
                prop_assert!(seen.len() <= points.len());
                prop_assert!(tree.leaves().all(|(number, _)| number < tree.n_leaves()));
                let mut numbers: Vec<usize> = tree.leaves().map(|leaf| leaf.0).collect();
                numbers.dedup();
                prop_assert_eq!(numbers.len(), tree.leaves().count());
                prop_assert!(tree.any(|_, _| true, |item| item as usize == points.len() - 1));
            }
        }
    }

    #[test]
    fn a_tree_of_nothing_has_no_nearest_item() {
        let tree = Tree::new(&[]);
        assert!(
            tree.nearest(Vec3::ZERO, f64::INFINITY, |_| 0.0, |_, _| 0.0).is_none() && !tree.any(|_, _| true, |_| true)
        );
    }
}
