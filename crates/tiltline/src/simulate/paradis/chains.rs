//! From nodes and arms to whole lines: chains of two-armed nodes between junctions and ends, unwrapped from the periodic box.

use super::{Arm, Network};
use crate::geometry::{Point3, Vector3};
use crate::simulate::foil::Dislocation;
use crate::simulate::geometry::polyline::{HalfSpace, Piece, clip};

/// Burgers vectors that differ by less than this share are the same: files are written with 8 digits or more.
const SAME_BURGERS: f64 = 1e-4;

impl Network {
    /// The lines of the network, unwrapped: each goes on through the faces of the box, so its points may lie outside.
    ///
    /// A line ends at a node that has not two arms, or whose two arms have different Burgers vectors. Its Burgers vector belongs to
    /// the order of its points. Its plane is given where all its segments have the same. A line that closes on itself is closed;
    /// one that comes back to another periodic image of its start is open, and its ends are images of each other.
    pub fn lines(&self) -> Vec<Dislocation> {
        let mut used = vec![false; self.segments];
        let mut lines = Vec::new();
        // First the lines with ends, from their ends; what is left then are rings.
        for rings in [false, true] {
            for (start, node) in self.nodes.iter().enumerate() {
                if !rings && self.passes(start).is_some() {
                    continue;
                }
                for arm in &node.arms {
                    if !used[arm.segment] {
                        lines.push(self.chain(start, arm, &mut used));
                    }
                }
            }
        }
        lines
    }

    /// The two arms of a node in the middle of a line.
    fn passes(&self, node: usize) -> Option<[&Arm; 2]> {
        let [one, two] = &self.nodes[node].arms[..] else { return None };
        let turned = (one.burgers_nm + two.burgers_nm).norm() <= SAME_BURGERS * one.burgers_nm.norm().max(1e-9);
        turned.then_some([one, two])
    }

    fn chain(&self, start: usize, first: &Arm, used: &mut [bool]) -> Dislocation {
        let burgers_nm = first.burgers_nm;
        let mut points = vec![self.nodes[start].position];
        let mut plane = first.plane_normal;
        let (mut arm, mut at) = (first, self.nodes[start].position);
        let mut closed = false;
        loop {
            used[arm.segment] = true;
            at += arm.step_nm;
            plane = plane.filter(|normal| arm.plane_normal.is_some_and(|own| same_plane(normal, &own)));
            points.push(at);
            let Some(both) = self.passes(arm.neighbour) else { break };
            let Some(next) = both.into_iter().find(|next| !used[next.segment]) else {
                // Back at the start. Rounding of the steps is far below a thousandth of a nm.
                closed = arm.neighbour == start && (at - points[0]).norm() < 1e-3;
                break;
            };
            arm = next;
        }
        if closed {
            points.pop();
        }
        Dislocation { points, closed, burgers_nm: (burgers_nm.norm() > 0.0).then_some(burgers_nm), plane_normal: plane }
    }

    /// The parts of the lines, and of their periodic images, in a convex region within the given bounds.
    ///
    /// Returns each part with its line (an index into `lines`). None where the region reaches over more than
    /// `most_images` images of the box.
    pub(crate) fn pieces_in(
        &self,
        lines: &[Dislocation],
        region: &[HalfSpace],
        [low, high]: [Point3; 2],
        most_images: f64,
    ) -> Option<Vec<(usize, Piece)>> {
        let size = self.size_nm();
        let reach = (high - low).component_div(&size);
        let images: f64 = reach.iter().map(|side| side + 1.0).product();
        if self.periodic && (images.is_nan() || images > most_images) {
            return None;
        }
        let mut pieces = Vec::new();
        for (index, line) in lines.iter().enumerate() {
            for image in self.images_in(line, [low, high]) {
                let shift = image.map(|number| number as f64).component_mul(&size);
                let points: Vec<Point3> = line.points.iter().map(|point| point + shift).collect();
                pieces.extend(clip(&points, line.closed, region).into_iter().map(|piece| (index, piece)));
            }
        }
        Some(pieces)
    }

    /// The periodic images in which some segment of a line comes within bounds, in order.
    fn images_in(&self, line: &Dislocation, [low, high]: [Point3; 2]) -> Vec<nalgebra::Vector3<i64>> {
        if !self.periodic {
            return vec![nalgebra::Vector3::zeros()];
        }
        let size = self.size_nm();
        let mut images = std::collections::BTreeSet::new();
        let closing = line.points.last().zip(line.points.first()).filter(|_| line.closed);
        let segments = line.points.windows(2).map(|pair| (&pair[0], &pair[1])).chain(closing);
        for (start, end) in segments {
            let [first, last] =
                [(low - start.sup(end)).component_div(&size), (high - start.inf(end)).component_div(&size)];
            let range = |axis: usize| first[axis].ceil() as i64..=last[axis].floor() as i64;
            for x in range(0) {
                for y in range(1) {
                    images.extend(range(2).map(|z| [x, y, z]));
                }
            }
        }
        images.into_iter().map(nalgebra::Vector3::from).collect()
    }

    /// The lines cut at the faces of the box: what the box holds, each part in its place. Without periodicity, parts outside
    /// the box are left out.
    pub fn lines_in_box(&self) -> Vec<Dislocation> {
        let lines = self.lines();
        let region = crate::simulate::geometry::polyline::box_region(self.low, self.high);
        let pieces = self.pieces_in(&lines, &region, [self.low, self.high], f64::INFINITY).unwrap_or_default();
        pieces
            .into_iter()
            .map(|(line, piece)| Dislocation { points: piece.points, closed: piece.closed, ..lines[line].clone() })
            .collect()
    }
}

fn same_plane(one: &Vector3, two: &Vector3) -> bool {
    // Either sign of a normal is the same plane; 1e-6 is a tenth of a degree.
    one.dot(two).abs() > 1.0 - 1e-6
}
