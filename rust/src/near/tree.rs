//! A tree of boxes over points: what is within a distance, and what is nearest, exact with ties.
//!
//! Halving the points across the longer sides of their boxes leaves leaves of the same size, so that neither the tree nor
//! its leaves need pointers. Boxes are compared by distances that are rounded as those of points are, in the same order of
//! operations: rounding is monotonic, so a point is never nearer than the box that it is in.

use crate::error::Error;
use crate::pool::Pool;

/// Points of a leaf; only the last leaf may have fewer.
pub(crate) const LEAF: usize = 16;

/// Leaves below which one thread grows a branch: enough branches for all threads, and each fits in a cache.
const ALONE: usize = 1024;

/// Leaves that a task searches from: enough to hide the queue, few enough to balance crowded and sparse regions.
pub(crate) const LEAVES_A_TASK: usize = 16;

/// Candidates listed before the nearest are told from the others, as a multiple of how many are wanted.
const CANDIDATES: usize = 2;

/// A point and its index.
#[derive(Clone, Copy)]
pub(crate) struct Entry<const N: usize> {
    pub(crate) point: [f64; N],
    pub(crate) index: usize,
}

/// The box of some points, and the smallest of their indices.
#[derive(Clone, Copy)]
struct Node<const N: usize> {
    low: [f64; N],
    high: [f64; N],
    first: usize,
}

impl<const N: usize> Node<N> {
    const EMPTY: Self = Self { low: [f64::INFINITY; N], high: [f64::NEG_INFINITY; N], first: usize::MAX };

    fn of(entries: &[Entry<N>]) -> Self {
        entries.iter().fold(Self::EMPTY, |node, entry| Self {
            low: std::array::from_fn(|axis| node.low[axis].min(entry.point[axis])),
            high: std::array::from_fn(|axis| node.high[axis].max(entry.point[axis])),
            first: node.first.min(entry.index),
        })
    }

    /// The squared distance from another box, or from a point as a box.
    fn square(&self, low: &[f64; N], high: &[f64; N]) -> f64 {
        let gap = |axis: usize| (self.low[axis] - high[axis]).max(low[axis] - self.high[axis]).max(0.0);
        (0..N).fold(0.0, |sum, axis| sum + gap(axis) * gap(axis))
    }

    /// The squared distance of a point from the corner that is farthest from it.
    fn farthest_square(&self, point: &[f64; N]) -> f64 {
        let gap = |axis: usize| (point[axis] - self.low[axis]).max(self.high[axis] - point[axis]);
        (0..N).fold(0.0, |sum, axis| sum + gap(axis) * gap(axis))
    }

    fn longest_side(&self) -> usize {
        let side = |axis: &usize| self.high[*axis] - self.low[*axis];
        (0..N).max_by(|a, b| side(a).total_cmp(&side(b))).unwrap_or(0)
    }
}

pub(crate) fn square<const N: usize>(a: &[f64; N], b: &[f64; N]) -> f64 {
    (0..N).fold(0.0, |sum, axis| sum + (a[axis] - b[axis]) * (a[axis] - b[axis]))
}

/// Nodes are in the order in which a depth-first walk meets them, entries in that of the leaves.
pub(crate) struct Tree<const N: usize> {
    nodes: Vec<Node<N>>,
    pub(crate) entries: Vec<Entry<N>>,
}

/// A node, by its place, and the leaves under it.
#[derive(Clone, Copy)]
struct Subtree {
    node: usize,
    leaf: usize,
    leaves: usize,
}

impl Subtree {
    /// A tree over so many leaves has a node less than twice as many.
    fn halves(self) -> [Self; 2] {
        let half = self.leaves / 2;
        let left = Self { node: self.node + 1, leaves: half, ..self };
        let right = Self { node: self.node + 2 * half, leaf: self.leaf + half, leaves: self.leaves - half };
        [left, right]
    }
}

impl<const N: usize> Tree<N> {
    pub(crate) fn new(points: &[[f64; N]], pool: &Pool<'_>) -> Result<Self, Error> {
        let mut entries: Vec<_> =
            points.iter().enumerate().map(|(index, &point)| Entry { point, index }).collect();
        let mut nodes = vec![Node::EMPTY; (2 * points.len().div_ceil(LEAF)).saturating_sub(1)];
        let mut branches = vec![Branch { entries: &mut entries, nodes: &mut nodes }];
        while branches.first().is_some_and(|branch| branch.entries.len() > ALONE * LEAF) {
            let mut halves: Vec<_> = branches.iter().map(|_| None).collect();
            pool.run(
                branches.into_iter().zip(&mut halves),
                || (),
                |(), (branch, halves)| *halves = branch.halve(),
            )?;
            branches = halves.into_iter().flatten().flatten().collect();
        }
        pool.run(branches.into_iter(), || (), |(), branch| branch.grow())?;
        Ok(Self { nodes, entries })
    }

    /// The entries of a leaf.
    pub(crate) fn leaf(&self, leaf: usize) -> &[Entry<N>] {
        &self.entries[leaf * LEAF..self.entries.len().min((leaf + 1) * LEAF)]
    }

    fn root(&self) -> Subtree {
        Subtree { node: 0, leaf: 0, leaves: self.entries.len().div_ceil(LEAF) }
    }
}

/// A part of a tree that is to be grown.
struct Branch<'a, const N: usize> {
    entries: &'a mut [Entry<N>],
    nodes: &'a mut [Node<N>],
}

impl<const N: usize> Branch<'_, N> {
    /// Fills in its own node; what is left to grow.
    fn halve(self) -> Option<[Self; 2]> {
        let (node, nodes) = self.nodes.split_first_mut()?;
        *node = Node::of(self.entries);
        let half = self.entries.len().div_ceil(LEAF) / 2;
        if half == 0 {
            return None;
        }
        // By index among equals, so that the first of many equal points are found without a look at the others.
        let axis = node.longest_side();
        self.entries.select_nth_unstable_by(half * LEAF, |a, b| {
            a.point[axis].total_cmp(&b.point[axis]).then(a.index.cmp(&b.index))
        });
        let (left, right) = self.entries.split_at_mut(half * LEAF);
        let (left_nodes, right_nodes) = nodes.split_at_mut(2 * half - 1);
        Some([Self { entries: left, nodes: left_nodes }, Self { entries: right, nodes: right_nodes }])
    }

    fn grow(self) {
        for half in self.halve().into_iter().flatten() {
            half.grow();
        }
    }
}

/// Finds the points within a distance of those of a leaf, or of one point.
pub(crate) struct Within<'a, const N: usize> {
    tree: &'a Tree<N>,
    limit: f64,
    pending: Vec<Subtree>,
    /// Leaves that reach near enough, by their nodes and their numbers.
    near: Vec<(usize, usize)>,
}

impl<'a, const N: usize> Within<'a, N> {
    /// Within a distance with this square.
    pub(crate) fn new(tree: &'a Tree<N>, limit: f64) -> Self {
        Self { tree, limit, pending: Vec::new(), near: Vec::new() }
    }

    /// Turns to a leaf of the tree; its entries.
    pub(crate) fn turn_to_leaf(&mut self, leaf: usize) -> &'a [Entry<N>] {
        let entries = self.tree.leaf(leaf);
        let Node { low, high, .. } = Node::of(entries);
        self.turn_to(&low, &high);
        entries
    }

    fn turn_to(&mut self, low: &[f64; N], high: &[f64; N]) {
        self.near.clear();
        self.pending.push(self.tree.root());
        while let Some(subtree) = self.pending.pop() {
            if self.tree.nodes[subtree.node].square(low, high) > self.limit {
                continue;
            }
            match subtree.leaves {
                1 => self.near.push((subtree.node, subtree.leaf)),
                _ => self.pending.extend(subtree.halves()),
            }
        }
    }

    /// Leaves near enough to a point of the box that it has turned to, and their nodes.
    fn leaves(&self, point: &[f64; N]) -> impl Iterator<Item = (&'a Node<N>, &'a [Entry<N>])> {
        let near = self.near.iter().map(|&(node, leaf)| (&self.tree.nodes[node], self.tree.leaf(leaf)));
        near.filter(|(node, _)| node.square(point, point) <= self.limit)
    }

    /// How many points are near enough to a point of the box that it has turned to.
    pub(crate) fn count(&self, point: &[f64; N]) -> usize {
        let near = |entry: &&Entry<N>| square(&entry.point, point) <= self.limit;
        self.leaves(point).map(|(_, leaf)| leaf.iter().filter(near).count()).sum()
    }

    /// Their indices, into a row that is as long as they are many or longer, in no order; how many they are.
    pub(crate) fn fill(&self, point: &[f64; N], row: &mut [usize]) -> usize {
        let mut filled = 0;
        for (node, entries) in self.leaves(point) {
            if node.farthest_square(point) <= self.limit {
                row[filled..].iter_mut().zip(entries).for_each(|(to, entry)| *to = entry.index);
                filled += entries.len();
                continue;
            }
            for entry in entries {
                // Written whether near or not: a branch here would be taken at random.
                if let Some(to) = row.get_mut(filled) {
                    *to = entry.index;
                }
                filled += usize::from(square(&entry.point, point) <= self.limit);
            }
        }
        filled
    }

    /// Replaces `out` by the indices of all that are near enough to a point, in no order.
    pub(crate) fn list(&mut self, point: &[f64; N], out: &mut Vec<usize>) {
        self.turn_to(point, point);
        out.resize(self.near.len() * LEAF, 0);
        let filled = self.fill(point, out);
        out.truncate(filled);
    }
}

/// Finds the nearest points: depth first, the nearer branches first.
pub(crate) struct Nearest<'a, const N: usize> {
    tree: &'a Tree<N>,
    /// Squared distances, as bits (which order numbers that are not negative), and indices.
    found: Vec<(u64, usize)>,
    /// The same of what a branch has at best.
    pending: Vec<((u64, usize), Subtree)>,
}

impl<'a, const N: usize> Nearest<'a, N> {
    pub(crate) fn new(tree: &'a Tree<N>) -> Self {
        Self { tree, found: Vec::new(), pending: Vec::new() }
    }

    /// Fills the row with the nearest of point `i`, itself one of them, in no order.
    pub(crate) fn fill(&mut self, i: usize, point: &[f64; N], row: &mut [usize]) {
        let k = row.len();
        for (to, &mut (_, j)) in row.iter_mut().zip(self.find(point, k)) {
            *to = j;
        }
        if !row.contains(&i) {
            row[k - 1] = i;
        }
    }

    /// The `k` nearest of a place, as squared distances (bits of them) and indices, the last of them last.
    pub(crate) fn find(&mut self, point: &[f64; N], k: usize) -> &mut [(u64, usize)] {
        self.found.clear();
        self.pending.push(((0, 0), self.tree.root()));
        let mut bound = (u64::MAX, usize::MAX);
        while let Some((best, subtree)) = self.pending.pop() {
            if best > bound {
                continue;
            }
            if subtree.leaves > 1 {
                let mut halves = subtree.halves().map(|half| (self.at_best(half, point), half));
                halves.sort_unstable_by_key(|(best, _)| std::cmp::Reverse(*best));
                self.pending.extend(halves);
                continue;
            }
            let seen =
                self.tree.leaf(subtree.leaf).iter().map(|e| (square(&e.point, point).to_bits(), e.index));
            self.found.extend(seen.filter(|seen| *seen <= bound));
            if self.found.len() >= CANDIDATES * k {
                bound = self.keep(k);
            }
        }
        self.keep(k);
        &mut self.found
    }

    fn at_best(&self, subtree: Subtree, point: &[f64; N]) -> (u64, usize) {
        let node = &self.tree.nodes[subtree.node];
        (node.square(point, point).to_bits(), node.first)
    }

    /// Drops all but the `k` nearest; the last of them.
    fn keep(&mut self, k: usize) -> (u64, usize) {
        let (_, &mut last, _) = self.found.select_nth_unstable(k - 1);
        self.found.truncate(k);
        last
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::AtomicBool;

    use super::*;

    fn points(n: usize) -> Vec<[f64; 2]> {
        (0..n).map(|i| [(i * 7919 % n) as f64, (i * 104_729 % 1009) as f64]).collect()
    }

    fn tree(points: &[[f64; 2]], threads: usize) -> Tree<2> {
        Tree::new(points, &Pool::new(threads, &AtomicBool::new(false))).unwrap()
    }

    #[test]
    fn every_node_is_the_box_of_its_leaves() {
        for n in [1, 15, 16, 17, 47, 300, 1000] {
            let tree = tree(&points(n), 1);
            let mut pending = vec![tree.root()];
            let mut visited = 0;
            while let Some(subtree) = pending.pop() {
                visited += 1;
                let range = subtree.leaf * LEAF..n.min((subtree.leaf + subtree.leaves) * LEAF);
                let (node, expected) = (tree.nodes[subtree.node], Node::of(&tree.entries[range]));
                assert_eq!((node.low, node.high, node.first), (expected.low, expected.high, expected.first));
                if subtree.leaves > 1 {
                    pending.extend(subtree.halves());
                }
            }
            assert_eq!(visited, tree.nodes.len());
            let mut indices: Vec<usize> = tree.entries.iter().map(|entry| entry.index).collect();
            indices.sort();
            assert_eq!(indices, (0..n).collect::<Vec<_>>());
        }
    }

    #[test]
    fn threads_grow_the_same_tree() {
        let points = points(3 * ALONE * LEAF);
        let order = |threads| tree(&points, threads).entries.iter().map(|e| e.index).collect::<Vec<_>>();
        assert_eq!(order(1), order(3));
    }

    #[test]
    fn searches_count_fill_and_list_the_same() {
        let points = points(500);
        let tree = tree(&points, 1);
        let mut search = Within::new(&tree, 80.0 * 80.0);
        let mut listed = Vec::new();
        for leaf in 0..500_usize.div_ceil(LEAF) {
            for entry in search.turn_to_leaf(leaf) {
                let mut row = vec![0; search.count(&entry.point)];
                search.fill(&entry.point, &mut row);
                Within::new(&tree, 80.0 * 80.0).list(&entry.point, &mut listed);
                row.sort();
                listed.sort();
                let near = |i: &usize| square(&points[*i], &entry.point) <= 80.0 * 80.0;
                assert_eq!(row, (0..500).filter(near).collect::<Vec<_>>());
                assert_eq!(row, listed);
            }
        }
    }
}
