//! The graph of a skeleton: junctions, and the branches of pixels between them.
//!
//! A pixel with three or more of its eight neighbours set belongs to a junction; touching ones are one junction.
//! Pixels are `[row, column]`.

use ndarray::Array2;

use crate::geometry::Point2;
use crate::trace::thin::{NEIGHBOURS, is_set};

/// Junctions and branches of a skeleton.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SkeletonGraph {
    /// Pixels of each junction.
    pub junctions: Vec<Vec<[usize; 2]>>,
    /// Paths between junctions and free ends, and loops.
    pub branches: Vec<Branch>,
}

/// A path of pixels without junctions.
#[derive(Clone, Debug, PartialEq)]
pub struct Branch {
    /// Its pixels in order, without those of the junctions at its ends; at least one, or none between two junctions
    /// that are joined by nothing else.
    pub pixels: Vec<[usize; 2]>,
    /// The junction at its first and last pixel, `None` at a free end.
    pub ends: [Option<usize>; 2],
    /// Whether it is a loop without any junction.
    pub closed: bool,
}

impl SkeletonGraph {
    /// The middle of a junction.
    pub fn junction_position(&self, index: usize) -> Point2 {
        let pixels = &self.junctions[index];
        let sum = pixels.iter().fold([0.0, 0.0], |sum, at| [sum[0] + at[1] as f64, sum[1] + at[0] as f64]);
        Point2::new(sum[0] / pixels.len() as f64, sum[1] / pixels.len() as f64)
    }
}

/// The graph of a skeleton as [`thin`](crate::trace::thin::thin) makes it.
pub fn skeleton_graph(skeleton: &Array2<bool>) -> SkeletonGraph {
    let neighbours = |[row, column]: [usize; 2]| {
        NEIGHBOURS.iter().filter_map(move |(down, right)| {
            let (row, column) = (row as isize + down, column as isize + right);
            is_set(skeleton, row, column).then_some([row as usize, column as usize])
        })
    };
    let pixels: Vec<[usize; 2]> =
        skeleton.indexed_iter().filter(|(_, set)| **set).map(|((row, column), _)| [row, column]).collect();

    // Junctions: touching pixels of three or more neighbours.
    const NONE: u32 = u32::MAX;
    let mut junction_at = Array2::from_elem(skeleton.dim(), NONE);
    let is_junction = |at: [usize; 2]| neighbours(at).count() >= 3;
    let mut junctions: Vec<Vec<[usize; 2]>> = Vec::new();
    for &start in &pixels {
        if junction_at[start] != NONE || !is_junction(start) {
            continue;
        }
        let index = junctions.len() as u32;
        junction_at[start] = index;
        let mut members = vec![start];
        let mut next = 0;
        while next < members.len() {
            for at in neighbours(members[next]) {
                if junction_at[at] == NONE && is_junction(at) {
                    junction_at[at] = index;
                    members.push(at);
                }
            }
            next += 1;
        }
        junctions.push(members);
    }
    let junction_of = |at: [usize; 2]| Some(junction_at[at]).filter(|index| *index != NONE).map(|index| index as usize);

    // Branches: from every pixel that is an end or touches a junction, then what is left are loops.
    let mut used = Array2::from_elem(skeleton.dim(), false);
    let mut branches = Vec::new();
    let mut follow = |start: [usize; 2], closed: bool| {
        if used[start] {
            return;
        }
        let mut path = vec![start];
        used[start] = true;
        let mut here = start;
        while let Some(next) = neighbours(here).find(|at| junction_of(*at).is_none() && !used[*at]) {
            used[next] = true;
            path.push(next);
            here = next;
        }
        let first: Vec<usize> = neighbours(start).filter_map(junction_of).collect();
        let last: Vec<usize> = neighbours(here).filter_map(junction_of).collect();
        let ends = if path.len() == 1 {
            [first.first().copied(), first.iter().copied().find(|other| Some(other) != first.first())]
        } else {
            [first.first().copied(), last.first().copied()]
        };
        // One pixel with both neighbours in the same junction is part of that junction's clump.
        let clump = path.len() == 1 && first.len() > 1 && ends[1].is_none();
        if !clump {
            branches.push(Branch { pixels: path, ends, closed });
        }
    };
    let free_neighbours = |at: [usize; 2]| neighbours(at).filter(|at| junction_of(*at).is_none()).count();
    for &start in pixels.iter().filter(|at| junction_of(**at).is_none()) {
        if free_neighbours(start) <= 1 {
            follow(start, false);
        }
    }
    for &start in pixels.iter().filter(|at| junction_of(**at).is_none()) {
        follow(start, true);
    }
    SkeletonGraph { junctions, branches }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn drawn(rows: &[&str]) -> Array2<bool> {
        Array2::from_shape_fn((rows.len(), rows[0].len()), |(row, column)| rows[row].as_bytes()[column] == b'#')
    }

    #[test]
    fn a_t_has_one_junction_and_three_branches() {
        let graph = skeleton_graph(&drawn(&[
            "...........", //
            ".#########.", //
            ".....#.....",
            ".....#.....",
            ".....#.....",
            "...........",
        ]));
        assert_eq!(graph.junctions.len(), 1);
        assert_eq!(graph.branches.len(), 3);
        assert!(graph.branches.iter().all(|branch| branch.ends.iter().flatten().count() == 1 && !branch.closed));
    }

    #[test]
    fn a_ring_is_one_closed_branch_and_a_diagonal_an_open_one() {
        let graph = skeleton_graph(&drawn(&["..###......", ".#...#...#.", ".#...#..#..", "..###..#..."]));
        assert!(graph.junctions.is_empty());
        let mut found: Vec<(usize, bool)> = graph.branches.iter().map(|b| (b.pixels.len(), b.closed)).collect();
        found.sort_unstable();
        assert_eq!(found, [(3, false), (10, true)]);
    }

    #[test]
    fn a_cross_has_four_branches_at_one_junction() {
        let graph = skeleton_graph(&drawn(&[
            "#.....#", //
            ".#...#.", "..#.#..", "...#...", "..#.#..", ".#...#.", "#.....#",
        ]));
        assert_eq!((graph.junctions.len(), graph.branches.len()), (1, 4));
        assert_eq!(graph.junction_position(0), Point2::new(3.0, 3.0));
    }
}
