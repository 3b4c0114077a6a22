//! Pareto front of cost and error.

/// Returns the points (cost, error) that have a smaller error than all cheaper ones, by cost.
pub fn front(points: impl IntoIterator<Item = (f64, f64)>) -> Vec<(f64, f64)> {
    let mut all: Vec<(f64, f64)> = points.into_iter().collect();
    all.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1)));
    let mut least = f64::INFINITY;
    all.retain(|(_, error)| {
        let better = *error < least;
        least = least.min(*error);
        better
    });
    all
}

#[cfg(test)]
mod tests {
    use super::front;

    #[test]
    fn each_point_has_a_smaller_error_than_all_cheaper_ones() {
        let points = [(2.0, 0.5), (1.0, 1.0), (1.0, 2.0), (3.0, 0.5), (4.0, 0.1), (f64::NAN, f64::NAN)];
        assert_eq!(front(points), [(1.0, 1.0), (2.0, 0.5), (4.0, 0.1)]);
    }
}
