//! Cells of a regular grid, and the triangles that meet each of them.

use std::ops::Range;

use crate::evaluate::triangles::SLACK;
use crate::sets::Sets;

/// Cells are that much larger than they are, in their own size: what rounding moves across an edge is found.
const MARGIN: f64 = 1e-6;

/// Most cells along an axis.
const MOST_CELLS: usize = 1024;

/// Most cells and rows of cells that are visited for a triangle, in the mean: where triangles overlap much, cells are larger.
const MOST_VISITS: usize = 32;

/// The grid, and the triangles of each cell, row after row.
#[derive(Clone, Debug)]
pub struct Cells {
    axes: [Axis; 2],
    lists: Sets<'static>,
}

/// Cells along an axis. The first and the last go on as far as there are points.
#[derive(Clone, Copy, Debug)]
struct Axis {
    reach: [f64; 2],
    low: f64,
    size: f64,
    per_unit: f64,
    number: usize,
    rounding: f64,
}

impl Cells {
    /// Numbered triangles by their corners, for points like the given ones: any in the box about these.
    pub fn new(triangles: &[(usize, [[f64; 2]; 3])], points: &[[f64; 2]]) -> Self {
        let spans = [0, 1].map(|b| {
            let reach = range(points.iter().map(|point| point[b]).filter(|x| x.is_finite()));
            let bulk = bulk(triangles.iter().flat_map(|(_, corners)| corners.map(|corner| corner[b])));
            (reach, [bulk[0].max(reach[0]), bulk[1].min(reach[1])])
        });
        let mut side = ((2.0 * triangles.len() as f64).sqrt().ceil() as usize).clamp(1, MOST_CELLS);
        loop {
            let axes = spans.map(|(reach, span)| Axis::new(reach, span, side));
            if let Some(lists) = lists(&axes, triangles) {
                return Self { axes, lists };
            }
            side /= 2; // A single cell is never too much.
        }
    }

    /// The triangles that may hold a point.
    pub fn at(&self, point: [f64; 2]) -> &[usize] {
        let [x, y] = &self.axes;
        self.lists.get(y.cell(point[1]) * x.number + x.cell(point[0]))
    }
}

/// None if these are too many.
fn lists(axes: &[Axis; 2], triangles: &[(usize, [[f64; 2]; 3])]) -> Option<Sets<'static>> {
    let [x, y] = axes;
    let mut lists = vec![Vec::new(); x.number * y.number];
    let mut visits = MOST_VISITS * triangles.len();
    for (t, corners) in triangles {
        let [(_, beside), (heights, above)] = [0, 1].map(|b| {
            let [low, high] = range(corners.iter().map(|corner| corner[b]));
            // Beyond its corners, a triangle holds what the slack allows.
            ([low, high], MARGIN * axes[b].size + axes[b].rounding + 3.0 * SLACK * (high - low))
        });
        for row in y.cells(heights, above) {
            let [bottom, top] = y.bounds(row);
            let columns = x.cells(between(corners, bottom - above, top + above), beside);
            visits = visits.checked_sub(1 + columns.len())?;
            for column in columns {
                lists[row * x.number + column].push(*t);
            }
        }
    }
    Some(lists.into_iter().collect())
}

impl Axis {
    fn new(reach: [f64; 2], span: [f64; 2], number: usize) -> Self {
        let [low, high] = if span[0] < span[1] { span } else { reach };
        let size = (high - low) / number as f64;
        let per_unit = size.recip();
        let rounding = 4.0 * f64::EPSILON * low.abs().max(high.abs());
        if per_unit.is_normal() {
            Self { reach, low, size, per_unit, number, rounding }
        } else {
            Self { reach, low, size: 0.0, per_unit: 0.0, number: 1, rounding }
        }
    }

    fn cell(&self, coordinate: f64) -> usize {
        (((coordinate - self.low) * self.per_unit) as usize).min(self.number - 1)
    }

    /// The cells that a range meets, to within a margin.
    fn cells(&self, [low, high]: [f64; 2], margin: f64) -> Range<usize> {
        let (low, high) = (low - margin, high + margin);
        if low > self.reach[1] || high < self.reach[0] {
            return 0..0;
        }
        self.cell(low)..self.cell(high) + 1
    }

    fn bounds(&self, cell: usize) -> [f64; 2] {
        let edge = |k: usize| self.low + k as f64 * self.size;
        [
            if cell == 0 { self.reach[0] } else { edge(cell) },
            if cell + 1 == self.number { self.reach[1] } else { edge(cell + 1) },
        ]
    }
}

/// Range along x of the part of a triangle between two heights; from infinity to minus infinity if there is none.
fn between(corners: &[[f64; 2]; 3], bottom: f64, top: f64) -> [f64; 2] {
    let sides = [[0, 1], [1, 2], [2, 0]].map(|side| side.map(|k| corners[k]));
    range(sides.into_iter().flat_map(|[start, end]| {
        let [start, end] = if start[1] < end[1] { [start, end] } else { [end, start] };
        // The ends of a level side are those of the others.
        let meets = start[1] < end[1] && start[1] <= top && end[1] >= bottom;
        let heights = [bottom.max(start[1]), top.min(end[1])];
        let shares = heights.map(|height| (height - start[1]) / (end[1] - start[1]));
        shares.map(|share| start[0] + share * (end[0] - start[0])).into_iter().filter(move |_| meets)
    }))
}

/// From infinity to minus infinity if there are none.
pub(super) fn range(numbers: impl Iterator<Item = f64>) -> [f64; 2] {
    numbers.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], x| [low.min(x), high.max(x)])
}

/// Range of nine tenths of numbers, and as much again on both sides: images that nearly reach a horizon are far away.
fn bulk(numbers: impl Iterator<Item = f64>) -> [f64; 2] {
    let mut numbers: Vec<_> = numbers.collect();
    if numbers.is_empty() {
        return [f64::NEG_INFINITY, f64::INFINITY];
    }
    let (first, last) = (numbers.len() / 20, numbers.len() - 1 - numbers.len() / 20);
    let mut number = |k: usize| *numbers.select_nth_unstable_by(k, f64::total_cmp).1;
    let (low, high) = (number(first), number(last));
    [low - (high - low), high + (high - low)]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Triangles of a width about the middles of a grid of 20 x 20 squares of side 1.
    fn example(width: f64) -> Vec<(usize, [[f64; 2]; 3])> {
        let corners = |t: usize| {
            let [x, y] = [t % 20, t / 20].map(|k| k as f64 + 0.5);
            [[x - width, y - width], [x + width, y - width], [x, y + width]]
        };
        (0..400).map(|t| (t, corners(t))).collect()
    }

    #[test]
    fn triangles_that_overlap_much_have_few_entries() {
        let cells = Cells::new(&example(15.0), &[[-20.0, -20.0], [40.0, 40.0]]);
        assert!(cells.lists.len() > 1 && cells.lists.items.len() <= MOST_VISITS * 400);
        for (t, corners) in example(15.0) {
            assert!(corners.iter().all(|corner| cells.at(*corner).contains(&t)));
        }
        let alike = vec![example(15.0)[0]; 400];
        assert_eq!(Cells::new(&alike, &[[0.0, 0.0], [1.0, 1.0]]).at([0.5, 0.5]).len(), 400);
    }

    #[test]
    fn what_is_far_does_not_widen_the_cells() {
        let mut triangles = example(0.4);
        triangles.push((400, [[0.0, 0.0], [1e9, 1e6], [1e9, 2e6]]));
        for points in [[[0.0, 0.0], [20.0, 20.0]], [[-1e9, -1e300], [1e9, 1e9]]] {
            let cells = Cells::new(&triangles, &points);
            assert!(cells.at([7.5, 7.5]).contains(&147) && cells.at([7.5, 7.5]).len() < 5);
            assert!(cells.at([19.9, 0.025]).contains(&400));
        }
        // A cell at the rim goes on to the last point.
        let cells = Cells::new(&triangles, &[[0.0, 0.0], [1e9, 1e9]]);
        assert!(cells.at([1e9, 1.5e6]).contains(&400) && !cells.at([-1e9, 1.5e6]).contains(&400));
    }

    #[test]
    fn a_point_alone_is_in_the_triangles_with_a_corner_there() {
        let corners = [[0.1, 0.3], [0.7, 0.2], [0.4, 0.9]];
        for point in corners {
            for near in [0.0, 1e-15, 1e-9] {
                let cells = Cells::new(&[(5, corners)], &[point, point.map(|x| x * (1.0 + near))]);
                assert_eq!(cells.at(point), [5]);
            }
        }
        assert!(Cells::new(&[(5, corners)], &[[0.1, 0.9]]).at([0.1, 0.9]).is_empty());
    }

    #[test]
    fn the_part_between_two_heights() {
        let corners = [[0.0, 0.0], [4.0, 0.0], [0.0, 4.0]];
        assert_eq!(between(&corners, 1.0, 2.0), [0.0, 3.0]);
        assert_eq!(between(&corners, -1.0, 0.0), [0.0, 4.0]);
        assert_eq!(between(&corners, 5.0, 6.0), [f64::INFINITY, f64::NEG_INFINITY]);
    }
}
