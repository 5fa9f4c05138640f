//! Which of many triangles hold a point.

use crate::evaluate::cells::Cells;

/// A point is in a triangle if no barycentric coordinate is below minus this, because of rounding.
pub(super) const SLACK: f64 = 1e-12;

/// Triangles, turning either way. A point asks the two or three that meet its cell.
#[derive(Clone, Debug)]
pub struct Triangles {
    triangles: Vec<Triangle>,
    cells: Cells,
}

#[derive(Clone, Copy, Debug)]
struct Triangle {
    edges: [Edge; 3],
    doubled_area: f64,
}

/// An edge from its smaller end, so that a point is on the same side of it for both triangles.
#[derive(Clone, Copy, Debug)]
struct Edge {
    start: [f64; 2],
    along: [f64; 2],
}

impl Triangles {
    /// Triangles by their corners; points will be asked for in the box about the given ones.
    pub fn new(corners: &[[[f64; 2]; 3]], points: &[[f64; 2]]) -> Self {
        let triangles: Vec<_> = corners.iter().map(Triangle::new).collect();
        let numbered = triangles.iter().zip(corners).enumerate();
        let proper: Vec<_> = numbered
            // Others are no triangles, or have no numbers.
            .filter(|(_, (triangle, _))| triangle.doubled_area != 0.0 && triangle.doubled_area.is_finite())
            .map(|(t, (_, corners))| (t, *corners))
            .collect();
        Self { triangles, cells: Cells::new(&proper, points) }
    }

    /// The triangles that hold a point, with its barycentric coordinates.
    ///
    /// ```
    /// use mexpress::evaluate::triangles::Triangles;
    /// let corners = [[[0.0, 0.0], [2.0, 0.0], [0.0, 2.0]], [[2.0, 2.0], [2.0, 0.0], [0.0, 2.0]]];
    /// let halves = Triangles::new(&corners, &[[0.0, 0.0], [2.0, 2.0]]);
    /// assert_eq!(halves.holding([0.5, 0.5]).collect::<Vec<_>>(), [(0, [0.5, 0.25, 0.25])]);
    /// assert_eq!(halves.holding([1.0, 1.0]).count(), 2);
    /// assert_eq!(halves.holding([3.0, 1.0]).count(), 0);
    /// ```
    pub fn holding(&self, point: [f64; 2]) -> impl Iterator<Item = (usize, [f64; 3])> {
        let shares = move |&t: &usize| (t, self.triangles[t].shares(point));
        self.cells.at(point).iter().map(shares).filter(|(_, shares)| least(shares) >= -SLACK)
    }

    /// The triangle that comes nearest to holding a point, of those about its cell.
    pub fn nearest(&self, point: [f64; 2]) -> Option<usize> {
        let depth = |&&t: &&usize| least(&self.triangles[t].shares(point));
        self.cells.at(point).iter().max_by(|s, t| depth(s).total_cmp(&depth(t))).copied()
    }
}

fn least(shares: &[f64; 3]) -> f64 {
    shares[0].min(shares[1]).min(shares[2])
}

impl Triangle {
    fn new(corners: &[[f64; 2]; 3]) -> Self {
        let [a, b, c] = *corners;
        let doubled_area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
        Self { edges: [Edge::between(b, c), Edge::between(c, a), Edge::between(a, b)], doubled_area }
    }

    /// Barycentric coordinates: the share of each corner is the height above the edge that is opposite to it.
    #[inline]
    fn shares(&self, point: [f64; 2]) -> [f64; 3] {
        self.edges.map(|edge| edge.height(point) / self.doubled_area)
    }
}

impl Edge {
    fn between(from: [f64; 2], to: [f64; 2]) -> Self {
        let start = if from <= to { from } else { to };
        Self { start, along: [to[0] - from[0], to[1] - from[1]] }
    }

    /// Twice the area of the triangle that the point makes with the edge, positive to its left.
    #[inline]
    fn height(&self, point: [f64; 2]) -> f64 {
        self.along[0] * (point[1] - self.start[1]) - self.along[1] * (point[0] - self.start[0])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Triangles that turn either way, some of them slivers.
    fn example() -> Vec<[[f64; 2]; 3]> {
        let number = |k: usize| (43_758.545 * (k as f64).sin()).fract().abs();
        let corner =
            |t: usize, c: usize, thin: f64| [0, 1].map(|b| thin * number(6 * t + 2 * c + b) + number(t));
        (0..60).map(|t| [0, 1, 2].map(|c| corner(t, c, [1.0, 0.1, 1e-3][t % 3]))).collect()
    }

    #[test]
    fn the_triangles_that_hold_a_point_are_those_of_all_that_do() {
        let corners = example();
        let found = Triangles::new(&corners, &[[0.0, 0.0], [2.0, 2.0]]);
        let mut held = 0;
        for k in 0..5000 {
            let point = [2.0 * (0.569_84 * f64::from(k)).fract(), 2.0 * (0.618_034 * f64::from(k)).fract()];
            let all = found.triangles.iter().enumerate().map(|(t, triangle)| (t, triangle.shares(point)));
            let all: Vec<_> = all.filter(|(_, shares)| least(shares) >= 0.0).collect();
            assert_eq!(found.holding(point).collect::<Vec<_>>(), all);
            held += all.len();
            for (t, shares) in all {
                for b in 0..2 {
                    let there: f64 = (0..3).map(|c| shares[c] * corners[t][c][b]).sum();
                    assert!((there - point[b]).abs() < 1e-10);
                }
            }
        }
        assert!(held > 1000);
    }

    #[test]
    fn a_point_is_on_one_side_of_an_edge_for_both_of_its_triangles() {
        let (a, b) = ([0.1, 0.3], [0.7, 0.9]);
        let (there, back) = (Edge::between(a, b), Edge::between(b, a));
        for k in 0..100 {
            let point = [0.1 + 0.006 * f64::from(k), 0.3 + 0.006 * f64::from(k)];
            assert_eq!(there.height(point), -back.height(point));
        }
    }

    #[test]
    fn what_is_no_triangle_holds_nothing() {
        let line = [[0.0, 0.0], [1.0, 1.0], [2.0, 2.0]];
        let nowhere = [[0.0, 0.0], [f64::NAN, 1.0], [2.0, 0.0]];
        let endless = [[0.0, 0.0], [f64::INFINITY, 1.0], [2.0, 0.0]];
        let found = Triangles::new(&[line, nowhere, endless], &[[0.0, 0.0], [2.0, 2.0]]);
        for point in [[1.0, 1.0], [1.0, 0.2], [f64::NAN, 0.0], [f64::INFINITY, -1e300]] {
            assert_eq!(found.holding(point).count(), 0);
        }
        assert_eq!(Triangles::new(&[], &[]).nearest([0.0, 0.0]), None);
    }
}
