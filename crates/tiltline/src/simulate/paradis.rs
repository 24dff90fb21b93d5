//! Reads dislocation networks from ParaDiS nodal data files (`.data`, versions 4 and 5).
//!
//! Format: ParaDiS user's guide (LLNL), "Nodal data file": parameters `name = value` or `name = [ values ]`, then `nodalData =`
//! with, for each node, a primary line `tag x y z num_arms constraint` and for each arm two secondary lines, `tag bx by bz` and
//! `nx ny nz`; a tag is `domain,index`; `#` starts a comment. The Burgers vector of an arm belongs to the line sense from its node
//! to its neighbour, so that each arm is listed twice with opposite Burgers vectors, and those of a node sum to zero
//! (except at pinned ends). Coordinates and Burgers vectors are in units of the magnitude of the Burgers vector.
//!
//! The box is periodic: an arm is the shortest way between its nodes' images. Everything is nm after reading.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use crate::geometry::{Point3, Vector3};

mod chains;
mod parse;

/// Largest file that is read, bytes.
pub const LARGEST_FILE: u64 = 512 << 20;
/// Most arms of one node.
pub const MOST_ARMS: usize = 64;

/// How a file is read.
#[derive(Clone, Debug, PartialEq)]
pub struct ReadOptions {
    /// Length of one unit of the file in nm, used where the file has no `burgMag` (metres).
    pub nm_per_unit: f64,
    /// Whether the box repeats itself in all directions (the file does not say).
    pub periodic: bool,
}

impl Default for ReadOptions {
    /// Units of 0.25 nm, about the Burgers vector of most metals; periodic.
    fn default() -> Self {
        Self { nm_per_unit: 0.25, periodic: true }
    }
}

/// Why a network was refused.
#[derive(Debug, thiserror::Error)]
pub enum ParadisError {
    /// The file cannot be read.
    #[error("cannot read {}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// The file is larger than any network that can be used here.
    #[error("{} has {bytes} bytes; networks of up to {LARGEST_FILE} bytes are read: cut it to the part that is needed", path.display())]
    TooLarge {
        /// The file.
        path: PathBuf,
        /// Its size.
        bytes: u64,
    },
    /// The text is not a nodal data file.
    #[error("line {line}: {problem}")]
    Syntax {
        /// Line number, from 1.
        line: usize,
        /// What was expected and what was found.
        problem: String,
    },
    /// A version that is not known.
    #[error("dataFileVersion is {found}; versions 4 and 5 are read: convert it with ParaDiS' own tools")]
    Version {
        /// The version in the file.
        found: f64,
    },
    /// The network is spread over several files.
    #[error("numFileSegments is {found}: the network is spread over several files; join them to one segment")]
    Segments {
        /// The number in the file.
        found: f64,
    },
    /// A unit that cannot be a length.
    #[error("one unit is {nm_per_unit} nm; give the magnitude of the Burgers vector in nm, 0.01 to 100")]
    Unit {
        /// The unit asked for or found (`burgMag`).
        nm_per_unit: f64,
    },
    /// The box is missing, inside out or of no size.
    #[error("the box goes from {low:?} to {high:?}; minCoordinates must be below maxCoordinates")]
    Box {
        /// minCoordinates.
        low: [f64; 3],
        /// maxCoordinates.
        high: [f64; 3],
    },
    /// The number of nodes is not what the header says.
    #[error("nodeCount is {declared} but the file has {found} nodes: it is cut off or was edited")]
    NodeCount {
        /// In the header.
        declared: f64,
        /// In the file.
        found: usize,
    },
    /// A node that cannot belong to the box.
    #[error("node {node} lies at {position:?}, thousands of boxes away: its coordinates or those of the box are wrong")]
    FarOutside {
        /// The node.
        node: Tag,
        /// Its coordinates in the file.
        position: [f64; 3],
    },
    /// Two nodes have one tag.
    #[error("line {line}: node {tag} is there twice")]
    Duplicate {
        /// Line of the second.
        line: usize,
        /// The tag.
        tag: Tag,
    },
    /// An arm leads nowhere.
    #[error("node {node} has an arm to node {missing}, which is not in the file: the network is incomplete")]
    MissingNode {
        /// Where the arm starts.
        node: Tag,
        /// Where it should end.
        missing: Tag,
    },
    /// An arm that its neighbour does not have.
    #[error("node {node} has an arm to node {neighbour}, which has none back: both must list it")]
    NotMutual {
        /// The node with the arm.
        node: Tag,
        /// The node without.
        neighbour: Tag,
    },
    /// Both nodes list the arm, but with Burgers vectors that are not opposite.
    #[error(
        "the arm between nodes {node} and {neighbour} has Burgers vectors that are not opposite: {from:?} and {back:?}"
    )]
    Burgers {
        /// One node.
        node: Tag,
        /// The other.
        neighbour: Tag,
        /// Burgers vector at the first, units of the file.
        from: [f64; 3],
        /// Burgers vector at the second.
        back: [f64; 3],
    },
    /// In a periodic box, it is open which image of the neighbour an arm leads to.
    #[error(
        "the arm between nodes {node} and {neighbour} spans half the box along {axis}: which periodic image it leads to cannot be \
         told; add a node in between, or read the network as not periodic"
    )]
    Wrap {
        /// One node.
        node: Tag,
        /// The other.
        neighbour: Tag,
        /// x, y or z.
        axis: char,
    },
}

/// Name of a node: domain and index.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Tag {
    /// Domain.
    pub domain: i64,
    /// Index in it.
    pub index: i64,
}

impl std::fmt::Display for Tag {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(formatter, "{},{}", self.domain, self.index)
    }
}

/// One end of a segment, as its node sees it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Arm {
    /// Index of the neighbour in [`Network::nodes`].
    pub neighbour: usize,
    /// Index of the segment; the neighbour's arm of the same segment has the same.
    pub segment: usize,
    /// Burgers vector in nm for the line sense from this node to the neighbour.
    pub burgers_nm: Vector3,
    /// Unit normal of the glide plane, if the file gives one.
    pub plane_normal: Option<Vector3>,
    /// From this node to the image of the neighbour that the arm leads to, nm.
    pub step_nm: Vector3,
}

/// A node of the network.
#[derive(Clone, Debug, PartialEq)]
pub struct Node {
    /// Its name in the file.
    pub tag: Tag,
    /// Its place in nm.
    pub position: Point3,
    /// The constraint number of the file: 0 free, 7 pinned.
    pub constraint: i64,
    /// The segments that meet here.
    pub arms: Vec<Arm>,
}

/// A dislocation network in a box.
#[derive(Clone, Debug, PartialEq)]
pub struct Network {
    /// Corner of the box with the smallest coordinates, nm.
    pub low: Point3,
    /// Corner with the largest coordinates, nm.
    pub high: Point3,
    /// Whether the box repeats itself.
    pub periodic: bool,
    /// The nodes, in the order of the file.
    pub nodes: Vec<Node>,
    /// Number of segments: half the number of arms.
    pub segments: usize,
}

impl Network {
    /// Reads a file.
    ///
    /// # Errors
    /// An unreadable or oversized file, and everything [`Network::parse`] refuses.
    pub fn read(path: &Path, options: &ReadOptions) -> Result<Self, ParadisError> {
        let io = |source| ParadisError::Io { path: path.to_owned(), source };
        let bytes = std::fs::metadata(path).map_err(io)?.len();
        if bytes > LARGEST_FILE {
            return Err(ParadisError::TooLarge { path: path.to_owned(), bytes });
        }
        // Comments may be in any encoding; everything that counts is ASCII.
        Self::parse(&String::from_utf8_lossy(&std::fs::read(path).map_err(io)?), options)
    }

    /// Reads the text of a file. The memory used is bounded by the length of the text.
    ///
    /// # Errors
    /// Text that is no nodal data file, another version, several segments, numbers that are not finite, missing or duplicate
    /// nodes, a wrong count, arms that are not mutual, and arms whose periodic image is open.
    pub fn parse(text: &str, options: &ReadOptions) -> Result<Self, ParadisError> {
        let file = parse::parse(text)?;
        let nm_per_unit = file.burgers_magnitude_m.map_or(options.nm_per_unit, |metres| metres * 1e9);
        if !(0.01..=100.0).contains(&nm_per_unit) {
            return Err(ParadisError::Unit { nm_per_unit });
        }
        let size = Vector3::from(file.high) - Vector3::from(file.low);
        // Written so that NaN fails; a box beyond 1e15 units would lose its nodes to rounding.
        if !size.iter().all(|&side| side > 1e-6 && side < 1e15) {
            return Err(ParadisError::Box { low: file.low, high: file.high });
        }
        let middle = (Vector3::from(file.low) + Vector3::from(file.high)) * 0.5;
        let far = |node: &&parse::RawNode| (Vector3::from(node.position) - middle).component_div(&size).amax() > 1e3;
        if let Some(node) = file.nodes.iter().find(far) {
            return Err(ParadisError::FarOutside { node: node.tag, position: node.position });
        }
        let by_tag: HashMap<Tag, usize> = file.nodes.iter().enumerate().map(|(at, node)| (node.tag, at)).collect();
        let mut nodes: Vec<Node> = file
            .nodes
            .iter()
            .map(|node| Node {
                tag: node.tag,
                position: Point3::from(node.position) * nm_per_unit,
                constraint: node.constraint,
                arms: Vec::with_capacity(node.arms.len()),
            })
            .collect();
        let segments = pair_arms(&file.nodes, &by_tag)?;
        let size_nm = size * nm_per_unit;
        for (at, node) in file.nodes.iter().enumerate() {
            for (arm, &segment) in node.arms.iter().zip(&segments.of_arm[at]) {
                let neighbour = by_tag[&arm.neighbour];
                let direct = nodes[neighbour].position - nodes[at].position;
                let step_nm = if options.periodic { shortest_image(direct, &size_nm) } else { Ok(direct) };
                let step_nm = step_nm.map_err(|axis| ParadisError::Wrap {
                    node: node.tag,
                    neighbour: arm.neighbour,
                    axis: ['x', 'y', 'z'][axis],
                })?;
                nodes[at].arms.push(Arm {
                    neighbour,
                    segment,
                    burgers_nm: Vector3::from(arm.burgers) * nm_per_unit,
                    plane_normal: Vector3::from(arm.plane).try_normalize(1e-6),
                    step_nm,
                });
            }
        }
        let (low, high) = (Point3::from(file.low) * nm_per_unit, Point3::from(file.high) * nm_per_unit);
        Ok(Self { low, high, periodic: options.periodic, nodes, segments: segments.count })
    }

    /// Sides of the box, nm.
    pub fn size_nm(&self) -> Vector3 {
        self.high - self.low
    }

    /// Length of all segments, nm.
    pub fn length_nm(&self) -> f64 {
        0.5 * self.nodes.iter().flat_map(|node| &node.arms).map(|arm| arm.step_nm.norm()).sum::<f64>()
    }

    /// Sum of the Burgers vectors that leave a node, nm: zero except where a line ends.
    pub fn burgers_sum_nm(&self, node: usize) -> Vector3 {
        self.nodes[node].arms.iter().map(|arm| arm.burgers_nm).sum()
    }
}

/// Which segment each arm of each node belongs to.
struct Segments {
    of_arm: Vec<Vec<usize>>,
    count: usize,
}

/// Finds for each arm the neighbour's arm back. Two nodes may be joined by several segments.
fn pair_arms(nodes: &[parse::RawNode], by_tag: &HashMap<Tag, usize>) -> Result<Segments, ParadisError> {
    const OPEN: usize = usize::MAX;
    let mut of_arm: Vec<Vec<usize>> = nodes.iter().map(|node| vec![OPEN; node.arms.len()]).collect();
    let mut count = 0;
    for (at, node) in nodes.iter().enumerate() {
        for (number, arm) in node.arms.iter().enumerate() {
            let missing = || ParadisError::MissingNode { node: node.tag, missing: arm.neighbour };
            let neighbour = *by_tag.get(&arm.neighbour).ok_or_else(missing)?;
            if of_arm[at][number] != OPEN {
                continue;
            }
            let not_mutual = ParadisError::NotMutual { node: node.tag, neighbour: arm.neighbour };
            if neighbour == at {
                return Err(not_mutual);
            }
            let free = nodes[neighbour].arms.iter().enumerate();
            let back = free.filter(|(other, back)| back.neighbour == node.tag && of_arm[neighbour][*other] == OPEN);
            let error = |burgers: &[f64; 3]| (Vector3::from(*burgers) + Vector3::from(arm.burgers)).norm();
            let Some((other, best)) = back.min_by(|a, b| error(&a.1.burgers).total_cmp(&error(&b.1.burgers))) else {
                return Err(not_mutual);
            };
            // Files are written with 8 digits or more.
            if error(&best.burgers) > 1e-4 * Vector3::from(arm.burgers).norm().max(1e-3) {
                let (from, back) = (arm.burgers, best.burgers);
                return Err(ParadisError::Burgers { node: node.tag, neighbour: arm.neighbour, from, back });
            }
            of_arm[at][number] = count;
            of_arm[neighbour][other] = count;
            count += 1;
        }
    }
    Ok(Segments { of_arm, count })
}

/// The shortest of a vector's periodic images, or the axis along which two are equally short to a part in 10^6 of the box.
fn shortest_image(direct: Vector3, size: &Vector3) -> Result<Vector3, usize> {
    let mut image = direct;
    for axis in 0..3 {
        image[axis] -= size[axis] * (direct[axis] / size[axis]).round();
        if image[axis].abs() > (0.5 - 1e-6) * size[axis] {
            return Err(axis);
        }
    }
    Ok(image)
}

#[cfg(test)]
mod tests;
