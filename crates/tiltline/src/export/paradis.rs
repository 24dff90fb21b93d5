//! `curves.data`: ParaDiS nodal data, version 4 (Arsenlis et al., Modelling Simul. Mater. Sci. Eng. 15 (2007) 553;
//! "ParaDiS User's Guide", section on nodal data files).
//!
//! Burgers vectors and glide planes are unknown from one pair of images and written as zero vectors, which a comment
//! says: fill them in before a simulation. Coordinates are in the unit of the result; a simulation reads them in units
//! of its `burgMag`. Nodes with a single arm are pinned (constraint 7), others are free (0).

use std::io::{self, Write};

use crate::export::graph::CurveGraph;
use crate::export::number::{fixed, length_decimals};
use crate::reconstruction::{LengthUnit, Reconstruction};

/// Constraint of a node that may not move.
const PINNED: u8 = 7;

/// Writes `curves.data`.
pub fn write(reconstruction: &Reconstruction, out: &mut (impl Write + ?Sized)) -> io::Result<()> {
    let frame = &reconstruction.frame;
    let decimals = length_decimals(frame);
    let graph = CurveGraph::new(reconstruction);
    let segments = graph.segments_of_nodes();
    let half = half_box(reconstruction, &graph).map(|value| fixed(value, decimals));

    writeln!(out, "dataFileVersion =   4")?;
    writeln!(out, "numFileSegments =   1")?;
    writeln!(out, "minCoordinates = [\n  -{}\n  -{}\n  -{}\n  ]", half[0], half[1], half[2])?;
    writeln!(out, "maxCoordinates = [\n  {}\n  {}\n  {}\n  ]", half[0], half[1], half[2])?;
    writeln!(out, "nodeCount =   {}", graph.nodes.len())?;
    writeln!(out, "dataDecompType =   2\ndataDecompGeometry = [\n  1\n  1\n  1\n  ]\n")?;
    writeln!(out, "#\n#  END OF DATA FILE PARAMETERS\n#")?;
    writeln!(out, "#  Written by Tiltline. BURGERS VECTORS AND GLIDE PLANES ARE UNKNOWN and written as zero.")?;
    match frame.unit {
        LengthUnit::Nm => writeln!(
            out,
            "#  Coordinates are in nm: set burgMag = 1.0e-09 (m), or divide by the Burgers magnitude in nm."
        )?,
        LengthUnit::Px => {
            writeln!(out, "#  Coordinates are in px: the pixel size is unknown, so no burgMag is right.")?
        }
    }
    writeln!(
        out,
        "#  Nodes with one arm (line ends) are pinned: constraint 7. The box is the field of view, not a crystal's period.\n#\n"
    )?;
    writeln!(out, "domainDecomposition =\n# Dom_ID  Minimum XYZ bounds   Maximum XYZ bounds")?;
    writeln!(out, "  0  -{} -{} -{}  {} {} {}", half[0], half[1], half[2], half[0], half[1], half[2])?;
    writeln!(out, "nodalData =")?;
    writeln!(out, "#  Primary lines: node_tag, x, y, z, num_arms, constraint")?;
    writeln!(out, "#  Secondary lines: arm_tag, burgx, burgy, burgz, nx, ny, nz")?;
    for (index, node) in graph.nodes.iter().enumerate() {
        let arms = &segments[index];
        let constraint = if arms.len() == 1 { PINNED } else { 0 };
        let [x, y, z] = [node.position.x, node.position.y, node.position.z].map(|value| fixed(value, decimals));
        writeln!(out, " 0,{index} {x} {y} {z} {} {constraint}", arms.len())?;
        for &arm in arms {
            let [a, b] = graph.segments[arm];
            let other = if a == index { b } else { a };
            writeln!(out, "   0,{other} 0.0 0.0 0.0\n       0.0 0.0 0.0")?;
        }
    }
    Ok(())
}

/// Half sides of a box about the origin: the field of view, and deep enough for all nodes with a pixel to spare.
fn half_box(reconstruction: &Reconstruction, graph: &CurveGraph) -> [f64; 3] {
    let (height, width) = reconstruction.rectified.left.dim();
    let pixel = reconstruction.frame.pixel;
    let mut half = [0.5 * width as f64 * pixel, 0.5 * height as f64 * pixel, pixel];
    for node in &graph.nodes {
        for (side, value) in half.iter_mut().zip(node.position.iter()) {
            *side = side.max(value.abs() + pixel);
        }
    }
    half
}
