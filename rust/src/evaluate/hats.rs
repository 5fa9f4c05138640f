//! Hat functions over triangles, continued outside their hull.
//!
//! Outside, `f(q) = f(h) + g(h) . (q - h)` with h the point of the hull nearest to q. At a corner on the hull, the slope g
//! is the mean over the triangles of the two adjacent hull edges; between corners it is interpolated.

use crate::error::Error;
use crate::evaluate::local::{Jet, Local};
use crate::evaluate::triangles::Triangles;

/// The hat functions of a triangulation.
#[derive(Clone, Debug)]
pub struct Hats {
    points: Vec<[f64; 2]>,
    corners: Vec<[usize; 3]>,
    gradients: Vec<[[f64; 2]; 3]>,
    triangles: Triangles,
    rim: Vec<Rim>,
}

/// An edge of the hull: its ends, and for each end the triangles of both hull edges there.
#[derive(Clone, Copy, Debug)]
struct Rim {
    ends: [usize; 2],
    beside: [[usize; 2]; 2],
}

/// The place of the hull that is nearest to a point outside.
struct Foot {
    rim: usize,
    share: f64,
    edge: [f64; 2],
    offset: [f64; 2],
    squared: f64,
}

impl Hats {
    /// The hat functions of a triangulation.
    ///
    /// Triangles turn counter-clockwise; `gradients` are those of the barycentric coordinate of each of their corners. The hull's
    /// edges are pairs of a triangle and its side, from the corner of that number to the next.
    pub fn new(
        points: &[f64],
        corners: &[usize],
        gradients: &[f64],
        hull: &[(usize, usize)],
    ) -> Result<Self, Error> {
        if gradients.len() != 2 * corners.len() {
            return Err(Error::Length { expected: 2 * corners.len(), given: gradients.len() });
        }
        let points = points.as_chunks().0.to_vec();
        let corners = corners.as_chunks::<3>().0.to_vec();
        let within = |index: usize, bound: usize| {
            if index < bound { Ok(()) } else { Err(Error::Index { index, bound }) }
        };
        corners.iter().flatten().try_for_each(|&k| within(k, points.len()))?;
        hull.iter().try_for_each(|&(t, side)| within(t, corners.len()).and(within(side, 3)))?;
        let mut beside = vec![[0; 2]; points.len()];
        let ends = |&(t, side): &(usize, usize)| [0, 1].map(|end| corners[t][(side + end) % 3]);
        for edge in hull {
            for (end, corner) in ends(edge).into_iter().enumerate() {
                beside[corner][end] = edge.0;
            }
        }
        let rim =
            hull.iter().map(ends).map(|ends| Rim { ends, beside: ends.map(|end| beside[end]) }).collect();
        let shapes: Vec<_> = corners.iter().map(|corners| corners.map(|k| points[k])).collect();
        let gradients = gradients.as_chunks().0.as_chunks().0.to_vec();
        let triangles = Triangles::new(&shapes, &points);
        Ok(Self { points, corners, gradients, triangles, rim })
    }

    /// The triangle of a point, if it is not outside.
    #[inline]
    fn triangle(&self, point: [f64; 2]) -> Option<usize> {
        self.triangles.holding(point).next().map(|(t, _)| t).or_else(|| {
            // Rounding may leave a hole at a corner, inside.
            let inside = self.rim.iter().all(|rim| {
                let [start, end] = rim.ends.map(|k| self.points[k]);
                (end[0] - start[0]) * (point[1] - start[1]) > (end[1] - start[1]) * (point[0] - start[0])
            });
            if inside { self.triangles.nearest(point) } else { None }
        })
    }

    fn foot(&self, point: [f64; 2]) -> Option<Foot> {
        let feet = self.rim.iter().enumerate().map(|(rim, Rim { ends: [start, end], .. })| {
            let (start, end) = (self.points[*start], self.points[*end]);
            let (edge, way) = (minus(end, start), minus(point, start));
            let share = (dot(way, edge) / dot(edge, edge)).clamp(0.0, 1.0);
            let offset = [0, 1].map(|b| way[b] - share * edge[b]);
            Foot { rim, share, edge, offset, squared: dot(offset, offset) }
        });
        feet.reduce(|best, foot| if foot.squared < best.squared { foot } else { best })
    }

    fn visit_outside(&self, point: [f64; 2], mut take: impl FnMut(usize, Jet)) {
        let Some(Foot { rim, share, edge, offset, .. }) = self.foot(point) else { return };
        // The derivative of the share, and those of the offset along x and y.
        let between = share > 0.0 && share < 1.0;
        let gain = edge.map(|edge_b| if between { edge_b / dot(edge, edge) } else { 0.0 });
        let shift = [0, 1].map(|b| [0, 1].map(|a| f64::from(u8::from(a == b)) - gain[b] * edge[a]));
        let Rim { ends, beside } = self.rim[rim];
        for (end, sign) in [(0, -1.0), (1, 1.0)] {
            let part = if end == 0 { 1.0 - share } else { share };
            let growth = gain.map(|gain| sign * gain);
            take(ends[end], [part, growth[0], growth[1]]);
            let reach = offset.map(|offset| part * offset);
            let moved = [0, 1].map(|b| [0, 1].map(|a| growth[b] * offset[a] + part * shift[b][a]));
            for t in beside[end] {
                for (function, gradient) in self.corners[t].iter().zip(self.gradients[t]) {
                    let jet = [reach, moved[0], moved[1]].map(|way| dot(gradient, way) / 2.0);
                    take(*function, jet);
                }
            }
        }
    }
}

impl Local for Hats {
    const MOST: usize = 14;

    fn count(&self) -> usize {
        self.points.len()
    }

    /// Outside, every edge of the hull is asked, twice.
    fn search(&self) -> usize {
        100 + 20 * self.rim.len()
    }

    #[inline]
    fn visit(&self, point: [f64; 2], mut take: impl FnMut(usize, Jet)) {
        let Some(t) = self.triangle(point) else { return self.visit_outside(point, take) };
        for k in 0..3 {
            let gradient = self.gradients[t][k];
            // From a corner where the function vanishes, not from the mean of all: near it no digits are lost.
            let way = minus(point, self.points[self.corners[t][(k + 2) % 3]]);
            take(self.corners[t][k], [dot(gradient, way), gradient[0], gradient[1]]);
        }
    }
}

fn minus(end: [f64; 2], start: [f64; 2]) -> [f64; 2] {
    [end[0] - start[0], end[1] - start[1]]
}

fn dot(a: [f64; 2], b: [f64; 2]) -> f64 {
    a[0] * b[0] + a[1] * b[1]
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::AtomicBool;

    use super::*;
    use crate::pool::Pool;

    /// A square of four triangles about its middle.
    fn square() -> Hats {
        let points = [0.0, 0.0, 2.0, 0.0, 2.0, 2.0, 0.0, 2.0, 1.0, 1.0];
        let corners = [0, 1, 4, 1, 2, 4, 2, 3, 4, 0, 4, 3];
        let gradients = [
            [-0.5, -0.5],
            [0.5, -0.5],
            [0.0, 1.0],
            [0.5, -0.5],
            [0.5, 0.5],
            [-1.0, 0.0],
            [0.5, 0.5],
            [-0.5, 0.5],
            [0.0, -1.0],
            [-0.5, -0.5],
            [1.0, 0.0],
            [-0.5, 0.5],
        ];
        Hats::new(&points, &corners, gradients.as_flattened(), &[(0, 0), (1, 0), (2, 0), (3, 2)]).unwrap()
    }

    #[test]
    fn a_pyramid_inside_and_outside() {
        let flag = AtomicBool::new(false);
        let pool = Pool::new(2, &flag);
        let pyramid = [0.0, 0.0, 0.0, 0.0, 1.0];
        let points = [1.0, 0.5, 1.5, 1.0, 1.0, 1.0, 1.0, -1.0, -1.0, -1.0, f64::NAN, 0.0];
        let values = square().values(&points, &pyramid, 1, &pool).unwrap();
        assert_eq!(values[..3], [0.5, 0.5, 1.0]);
        // Slopes at corners are means: (0.5, 0.5) at (0, 0), (-0.5, 0.5) at (2, 0).
        assert_eq!(values[3..5], [-0.5, -1.0]);
        assert!(values[5].is_nan());
        let slopes = square().slopes(&points[..10], &pyramid, 1, &pool).unwrap();
        assert_eq!(slopes[..4], [0.0, 1.0, -1.0, 0.0]);
        assert_eq!(slopes[8..], [0.5, 0.5]);
        assert_eq!(slopes[6..8], [0.0, 0.5]);
    }

    #[test]
    fn slopes_are_the_limits_of_differences() {
        let flag = AtomicBool::new(false);
        let pool = Pool::new(1, &flag);
        let parameters = [0.3, -1.0, 0.7, 2.0, 0.1];
        let points: Vec<f64> = (0..400).map(|k| 9.0 * (0.7548 * f64::from(k)).fract() - 3.5).collect();
        let slopes = square().slopes(&points, &parameters, 1, &pool).unwrap();
        for axis in 0..2 {
            let at = |step: f64| {
                let moved = points.iter().enumerate().map(|(i, x)| if i % 2 == axis { x + step } else { *x });
                square().values(&moved.collect::<Vec<_>>(), &parameters, 1, &pool).unwrap()
            };
            for (i, (high, low)) in at(1e-7).iter().zip(at(-1e-7)).enumerate() {
                assert!((slopes[2 * i + axis] - (high - low) / 2e-7).abs() < 1e-6, "{i}");
            }
        }
    }

    #[test]
    fn what_is_no_triangulation_is_refused() {
        assert!(Hats::new(&[0.0; 6], &[0, 1, 3], &[0.0; 6], &[]).is_err());
        assert!(Hats::new(&[0.0; 6], &[0, 1, 2], &[0.0; 4], &[]).is_err());
        assert!(Hats::new(&[0.0; 6], &[0, 1, 2], &[0.0; 6], &[(0, 3)]).is_err());
        assert!(Hats::new(&[0.0; 6], &[0, 1, 2], &[0.0; 6], &[(1, 0)]).is_err());
    }
}
