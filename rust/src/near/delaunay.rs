//! Neighbours in the Delaunay triangulation of points in the plane.

use spade::{DelaunayTriangulation, Point2, Triangulation, mitigate_underflow};

use crate::error::Error;
use crate::near::neighbours::{scaled, unit_scale};
use crate::pool::Pool;
use crate::sets::{MOST_MEMBERS, Sets};

/// For every point, itself, the points that coincide with it, and those at the places joined to its own by an
/// edge of the Delaunay triangulation, sorted by index.
///
/// Points on one line have their neighbours along it. Where more than three points lie on an empty circle one
/// of the valid triangulations is taken, always the same. Magnitudes below 2^-142 of the largest count as
/// zero. Fails if the number of coordinates is odd or, naming the first of them, if some are not finite.
///
/// ```
/// use mexpress::near::delaunay::delaunay;
/// let never = std::sync::atomic::AtomicBool::new(false);
/// let points = [0.0, 0.0, 1.0, 0.0, 2.0, 0.0, 2.0, 0.0];
/// let sets = delaunay(&points, &mexpress::pool::Pool::new(1, &never))?;
/// assert_eq!(sets.get(0), &[0, 1]);
/// assert_eq!(sets.get(2), &[1, 2, 3]);
/// # Ok::<(), mexpress::error::Error>(())
/// ```
pub fn delaunay(points: &[f64], pool: &Pool<'_>) -> Result<Sets<'static>, Error> {
    if points.len() % 2 == 1 {
        return Err(Error::Length { expected: points.len() - 1, given: points.len() });
    }
    let scale = unit_scale(points.iter().copied())?;
    let flushed = scaled::<2>(points, 2, scale).into_iter().map(|[x, y]| {
        let safe = mitigate_underflow(Point2::new(x, y));
        [safe.x, safe.y]
    });
    let flushed: Vec<_> = flushed.collect();
    let (members, joined) = pool.aside(move || {
        let (distinct, members) = places(&flushed);
        joined_places(&distinct).map(|joined| (members, joined))
    })??;
    let mut place_of = vec![0; points.len() / 2];
    for place in 0..members.len() {
        for &i in members.get(place) {
            place_of[i] = place;
        }
    }
    let size = |place: usize| members.get(place).len();
    let joined_data = |place: usize| joined[place].iter().map(|&other| size(other)).sum::<usize>();
    if (0..members.len()).map(|place| size(place) * joined_data(place)).sum::<usize>() > MOST_MEMBERS {
        return Err(Error::TooMany { most: MOST_MEMBERS });
    }
    Ok(place_of.into_iter().map(|place| data_at(&joined[place], &members)).collect())
}

/// The distinct places, and the points at each of them, sorted.
fn places(points: &[[f64; 2]]) -> (Vec<[f64; 2]>, Sets<'static>) {
    let mut items: Vec<usize> = (0..points.len()).collect();
    items.sort_unstable_by(|&i, &j| {
        let by_place = points[i].partial_cmp(&points[j]).unwrap_or(std::cmp::Ordering::Equal);
        by_place.then(i.cmp(&j))
    });
    let (mut distinct, mut offsets) = (Vec::new(), vec![0]);
    for group in items.chunk_by(|&i, &j| points[i] == points[j]) {
        distinct.push(points[group[0]]);
        offsets.push(offsets[distinct.len() - 1] + group.len());
    }
    (distinct, (offsets, items).into())
}

fn data_at(places: &[usize], members: &Sets) -> Vec<usize> {
    let mut data: Vec<usize> = places.iter().flat_map(|&place| members.get(place)).copied().collect();
    data.sort_unstable();
    data
}

/// For every place (in lexicographic order), itself and the places that share an edge with it.
fn joined_places(distinct: &[[f64; 2]]) -> Result<Vec<Vec<usize>>, Error> {
    let mut joined: Vec<Vec<usize>> = (0..distinct.len()).map(|place| vec![place]).collect();
    // The triangulation of points on a line takes quadratic time, and their order tells everything.
    let edges: Vec<[usize; 2]> = if on_one_line(distinct)? {
        (1..distinct.len()).map(|place| [place - 1, place]).collect()
    } else {
        let edges = triangulation(distinct)?;
        edges.undirected_edges().map(|edge| edge.vertices().map(|vertex| vertex.index())).collect()
    };
    for [a, b] in edges {
        joined[a].push(b);
        joined[b].push(a);
    }
    Ok(joined)
}

/// Decided exactly, by the triangulation's own predicates.
fn on_one_line(distinct: &[[f64; 2]]) -> Result<bool, Error> {
    let [first, between @ .., last] = distinct else { return Ok(true) };
    for &place in between {
        if !triangulation(&[*first, place, *last])?.all_vertices_on_line() {
            return Ok(false);
        }
    }
    Ok(true)
}

fn triangulation(distinct: &[[f64; 2]]) -> Result<DelaunayTriangulation<Point2<f64>>, Error> {
    let vertices = distinct.iter().map(|&[x, y]| Point2::new(x, y)).collect();
    // Stable: vertices keep their positions. It fails on coordinates out of range only, and these are scaled.
    DelaunayTriangulation::bulk_load_stable(vertices).map_err(|_| Error::NotFinite { index: 0 })
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn triangulated(points: &[f64]) -> Result<Sets<'static>, Error> {
        delaunay(points, &Pool::new(1, &std::sync::atomic::AtomicBool::new(false)))
    }

    type Place = [i64; 2];

    /// Exact for the small integers of these tests.
    fn turn(a: Place, b: Place, c: Place) -> i64 {
        (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
    }

    /// Positive when `d` is inside the circle through `a`, `b`, `c`, which turn left.
    fn inside(a: Place, b: Place, c: Place, d: Place) -> i64 {
        let lifted = |p: Place| {
            let (x, y) = (p[0] - d[0], p[1] - d[1]);
            (x, y, x * x + y * y)
        };
        let ((ax, ay, aw), (bx, by, bw), (cx, cy, cw)) = (lifted(a), lifted(b), lifted(c));
        ax * (by * cw - bw * cy) - ay * (bx * cw - bw * cx) + aw * (bx * cy - by * cx)
    }

    /// How many places lie strictly inside, and (itself apart) on, the circle through a triangle's corners.
    fn circle(places: &[Place], [a, b, c]: [Place; 3]) -> (usize, usize) {
        let [b, c] = if turn(a, b, c) > 0 { [b, c] } else { [c, b] };
        let sides: Vec<i64> = places.iter().map(|&d| inside(a, b, c, d)).collect();
        (sides.iter().filter(|&&s| s > 0).count(), sides.iter().filter(|&&s| s == 0).count())
    }

    fn triangles(places: &[Place]) -> Vec<[usize; 3]> {
        let n = places.len();
        let all = (0..n).flat_map(|a| (a + 1..n).flat_map(move |b| (b + 1..n).map(move |c| [a, b, c])));
        all.filter(|t| turn(places[t[0]], places[t[1]], places[t[2]]) != 0).collect()
    }

    /// Pairs next to each other on one line.
    fn along_line(places: &[Place]) -> Vec<[usize; 2]> {
        let mut order: Vec<usize> = (0..places.len()).collect();
        order.sort_by_key(|&i| places[i]);
        order.windows(2).map(|w| [w[0].min(w[1]), w[0].max(w[1])]).collect()
    }

    /// Checks edges against the definition: those that every triangulation has are there, every one has an
    /// empty circle, and their number is that of a full triangulation (so none is missing and none cross).
    fn check(places: &[Place], edges: &[[usize; 2]]) {
        let triangles = triangles(places);
        if triangles.is_empty() {
            let mut line = along_line(places);
            line.sort();
            assert_eq!(edges, line);
            return;
        }
        let (mut required, mut allowed) = (Vec::new(), Vec::new());
        for t in triangles {
            let (interior, on) = circle(places, t.map(|i| places[i]));
            if interior == 0 {
                let sides = [[t[0], t[1]], [t[0], t[2]], [t[1], t[2]]];
                allowed.extend(sides);
                required.extend(sides.into_iter().filter(|_| on == 3));
            }
        }
        assert!(required.iter().all(|edge| edges.contains(edge)), "an edge is missing");
        assert!(edges.iter().all(|edge| allowed.contains(edge)), "an edge has no empty circle");
        for (i, &[a, b]) in edges.iter().enumerate() {
            for &[c, d] in &edges[..i] {
                let [a, b, c, d] = [a, b, c, d].map(|i| places[i]);
                let across = |p, q, r, s| turn(p, q, r).signum() * turn(p, q, s).signum() < 0;
                assert!(!(across(a, b, c, d) && across(c, d, a, b)), "edges cross");
            }
        }
        assert_eq!(edges.len(), 3 * places.len() - 3 - on_hull(places));
    }

    /// Places on the boundary of the convex hull, those inside its sides included.
    fn on_hull(places: &[Place]) -> usize {
        let outside = |&a: &Place| {
            places.iter().any(|&b| {
                let sides = || places.iter().map(move |&c| turn(a, b, c));
                a != b && sides().all(|s| s >= 0) && sides().any(|s| s > 0)
            })
        };
        places.iter().filter(|a| outside(a)).count()
    }

    /// Distinct places in the order of first appearance, and each datum's place.
    fn distinct(data: &[Place]) -> (Vec<Place>, Vec<usize>) {
        let mut places: Vec<Place> = Vec::new();
        let mut place_of = Vec::new();
        for datum in data {
            let known = places.iter().position(|place| place == datum);
            place_of.push(known.unwrap_or(places.len()));
            if known.is_none() {
                places.push(*datum);
            }
        }
        (places, place_of)
    }

    fn check_sets(data: &[Place], scale: f64) {
        let points: Vec<f64> = data.iter().flatten().map(|&c| c as f64 * scale).collect();
        let sets = triangulated(&points).unwrap();
        assert_eq!(sets, triangulated(&points).unwrap());
        assert_eq!(sets.len(), data.len());
        let (places, place_of) = distinct(data);
        let first: Vec<usize> =
            (0..places.len()).map(|p| place_of.iter().position(|&q| p == q).unwrap()).collect();
        let joined = |a: usize, b: usize| sets.get(first[a]).contains(&first[b]);
        let edges: Vec<[usize; 2]> = (0..places.len())
            .flat_map(|a| (a + 1..places.len()).map(move |b| [a, b]))
            .filter(|&[a, b]| joined(a, b))
            .collect();
        check(&places, &edges);
        for i in 0..data.len() {
            let (p, is_near) = (place_of[i], |q| q == place_of[i] || joined(place_of[i], q));
            assert!(is_near(p));
            let expected: Vec<usize> = (0..data.len()).filter(|&j| is_near(place_of[j])).collect();
            assert_eq!(sets.get(i), expected);
        }
    }

    fn clouds() -> impl Strategy<Value = Vec<Place>> {
        (0_usize..18, prop_oneof![Just(1_i64), Just(3), Just(1000)], any::<bool>()).prop_flat_map(
            |(n, size, line)| {
                let place = (-size..=size, -size..=size);
                let place = place.prop_map(move |(x, y)| if line { [x, 3 * x - 1] } else { [x, y] });
                prop::collection::vec(place, n)
            },
        )
    }

    proptest! {
        #[test]
        fn circles_are_empty(data in clouds(), exponent in prop_oneof![Just(0), -1000..1000]) {
            check_sets(&data, 2_f64.powi(exponent));
        }
    }

    #[test]
    fn grids_lines_and_circles() {
        let grid: Vec<Place> = (0..25).map(|i| [i % 5, i / 5]).collect();
        check_sets(&grid, 1.0);
        check_sets(&(0..9).map(|i| [i * 7 % 9, 4]).collect::<Vec<_>>(), 0.5);
        check_sets(&[[5, 0], [4, 3], [3, 4], [0, 5], [-3, 4], [-4, -3], [0, -5], [0, 0]], 1.0);
    }

    #[test]
    fn few_points() {
        assert!(triangulated(&[]).unwrap().is_empty());
        assert_eq!(*triangulated(&[1.0, 2.0]).unwrap().items, [0]);
        assert_eq!(*triangulated(&[1.0, 2.0, 3.0, 4.0]).unwrap().items, [0, 1, 0, 1]);
        assert_eq!(*triangulated(&[1.0, 2.0, 1.0, 2.0]).unwrap().items, [0, 1, 0, 1]);
        assert_eq!(*triangulated(&[0.0; 6]).unwrap().items, [0, 1, 2, 0, 1, 2, 0, 1, 2]);
    }

    #[test]
    fn any_finite_magnitude_will_do() {
        for size in [f64::MAX, 1e-300, 5e-324] {
            let sets = triangulated(&[0.0, 0.0, size, 0.0, 0.0, -size]).unwrap();
            assert_eq!(*sets.items, [0, 1, 2, 0, 1, 2, 0, 1, 2], "{size}");
        }
        // Next to the largest, subnormal coordinates are zero: their points coincide.
        assert_eq!(triangulated(&[0.0, 0.0, 1e-310, 0.0, 1.0, 0.0]).unwrap().get(0), &[0, 1, 2]);
    }

    #[test]
    fn unusable_points_are_named() {
        assert_eq!(triangulated(&[1.0; 3]), Err(Error::Length { expected: 2, given: 3 }));
        assert_eq!(triangulated(&[1.0, f64::INFINITY]), Err(Error::NotFinite { index: 1 }));
    }
}
