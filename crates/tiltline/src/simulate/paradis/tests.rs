//! Round numbers on small networks, and real ones where they are at hand.

use approx::assert_relative_eq;
use nalgebra::UnitQuaternion;
use proptest::prelude::*;

use super::*;
use crate::simulate::foil::Dislocation;
use crate::simulate::geometry::polyline;
use crate::simulate::slab::{Cut, CutError, foil_from_network};

const UNIT: ReadOptions = ReadOptions { nm_per_unit: 1.0, periodic: true };

fn header(half: f64, count: usize) -> String {
    format!(
        "dataFileVersion =   4\nnumFileSegments =   1\nminCoordinates = [\n  {0:e}\n  {0:e}\n  {0:e}\n  ]\nmaxCoordinates = [ {1:e} {1:e} {1:e} ]\n\
         nodeCount =   {count}\ndataDecompType =   1\ndataDecompGeometry = [\n  1\n  1\n  1\n  ]\n#\n#  END OF DATA FILE PARAMETERS\n#\n\n\
         domainDecomposition =\n {0}\n     {0}\n         {0}\n    {1}\n      {1}\n  {1}\n\nnodalData =\n\
         #  Primary lines: node_tag, x, y, z, num_arms, constraint\n",
        -half, half
    )
}

/// A pinned straight segment of 800 along x at z = 60, in a box of 2000; b in the plane (0 1 1).
fn frank_read() -> String {
    header(1000.0, 3)
        + "  0,0 -400.0 50.0 60.0 1 7\n    0,1 0.5 0.5 -0.5\n        0. 1. 1.\n\
           0,1 100.0 50.0 60.0 2 0\n    0,0 -0.5 -0.5 0.5\n        0. 1. 1.\n    0,2 0.5 0.5 -0.5\n        0. 1. 1.\n\
           0,2 400.0 50.0 60.0 1 7\n    0,1 -0.5 -0.5 0.5\n        0. 1. 1.\n"
}

/// Two lines that share a junction of length 100 along z between nodes 0,0 and 0,1; four pinned ends.
fn junction() -> String {
    header(1000.0, 6)
        + "0,0 0 0 -50 3 0\n 0,1 0 2 2\n 0 0 0\n 0,2 -1 -1 -1\n 0 0 0\n 0,3 1 -1 -1\n 0 0 0\n\
           0,1 0 0 50 3 0\n 0,0 0 -2 -2\n 0 0 0\n 0,4 1 1 1\n 0 0 0\n 0,5 -1 1 1\n 0 0 0\n\
           0,2 0 -300 -450 1 7\n 0,0 1 1 1\n 0 0 0\n\
           0,3 -300 0 -450 1 7\n 0,0 -1 1 1\n 0 0 0\n\
           0,4 0 300 450 1 7\n 0,1 -1 -1 -1\n 0 0 0\n\
           0,5 300 0 450 1 7\n 0,1 1 -1 -1\n 0 0 0\n"
}

/// A straight line through the whole periodic box of 100, along x at y = z = 10: it closes on its own image.
fn endless() -> String {
    header(50.0, 4)
        + "0,0 -40 10 10 2 0\n 0,1 1 0 0\n 0 0 1\n 0,3 -1 0 0\n 0 0 1\n\
           0,1 -10 10 10 2 0\n 0,2 1 0 0\n 0 0 1\n 0,0 -1 0 0\n 0 0 1\n\
           0,2 20 10 10 2 0\n 0,3 1 0 0\n 0 0 1\n 0,1 -1 0 0\n 0 0 1\n\
           0,3 45 10 10 2 0\n 0,0 1 0 0\n 0 0 1\n 0,2 -1 0 0\n 0 0 1\n"
}

fn length_nm(lines: &[Dislocation]) -> f64 {
    lines.iter().map(|line| polyline::length(&line.points, line.closed)).sum()
}

#[test]
fn a_pinned_segment_is_one_line_with_its_burgers_vector_and_plane() {
    let network = Network::parse(&frank_read(), &ReadOptions { nm_per_unit: 0.5, periodic: true }).unwrap();
    assert_eq!((network.nodes.len(), network.segments), (3, 2));
    assert_relative_eq!(network.length_nm(), 400.0, epsilon = 1e-9);
    let lines = network.lines();
    assert_eq!(lines.len(), 1);
    let line = &lines[0];
    assert_eq!(line.points, [[-200.0, 25.0, 30.0], [50.0, 25.0, 30.0], [200.0, 25.0, 30.0]].map(Point3::from));
    // For the sense from the first point to the last.
    assert_eq!(line.burgers_nm, Some(Vector3::new(0.25, 0.25, -0.25)));
    assert_relative_eq!(line.plane_normal.unwrap(), Vector3::new(0.0, 1.0, 1.0).normalize(), epsilon = 1e-12);
    assert_eq!((network.nodes[0].constraint, line.closed), (7, false));
}

#[test]
fn the_unit_in_the_file_wins_over_the_given_one() {
    let text = frank_read().replace("nodeCount", "burgMag = 2.5e-10\nnodeCount");
    let network = Network::parse(&text, &UNIT).unwrap();
    assert_relative_eq!(network.length_nm(), 800.0 * 0.25, epsilon = 1e-9);
}

#[test]
fn a_junction_is_five_lines_that_balance_at_both_nodes() {
    let network = Network::parse(&junction(), &UNIT).unwrap();
    let lines = network.lines();
    assert_eq!(lines.len(), 5);
    assert_relative_eq!(network.length_nm(), 100.0 + 4.0 * 500.0, epsilon = 1e-9);
    assert_relative_eq!(length_nm(&lines), network.length_nm(), epsilon = 1e-9);
    for node in [0, 1] {
        assert_eq!(network.burgers_sum_nm(node), Vector3::zeros());
        let place = network.nodes[node].position;
        let outwards = lines.iter().filter_map(|line| {
            let burgers = line.burgers_nm.unwrap();
            let [first, last] = [line.points[0], line.points[line.points.len() - 1]];
            if first == place { Some(burgers) } else { (last == place).then_some(-burgers) }
        });
        assert_eq!(outwards.sum::<Vector3>(), Vector3::zeros());
    }
    // No plane is given there, so none is claimed.
    assert!(lines.iter().all(|line| line.plane_normal.is_none()));
}

#[test]
fn a_line_through_the_box_is_unwrapped_and_cut_at_the_faces() {
    let network = Network::parse(&endless(), &UNIT).unwrap();
    assert_relative_eq!(network.length_nm(), 100.0, epsilon = 1e-9);
    let lines = network.lines();
    assert_eq!((lines.len(), lines[0].closed), (1, false));
    // From node 0 once through the box to the image of node 0.
    assert_relative_eq!(lines[0].points[4] - lines[0].points[0], Vector3::new(100.0, 0.0, 0.0), epsilon = 1e-9);
    let mut boxed = network.lines_in_box();
    boxed.sort_by(|a, b| a.points[0].x.total_cmp(&b.points[0].x));
    assert_eq!(boxed.len(), 2);
    assert_relative_eq!(boxed[0].points[0].x, -50.0, epsilon = 1e-9);
    assert_relative_eq!(length_nm(&boxed), 100.0, epsilon = 1e-9);
}

#[test]
fn a_foil_of_an_endless_line_repeats_it_beyond_the_box() {
    let network = Network::parse(&endless(), &UNIT).unwrap();
    // Turned about z by 90 degrees, x of the network becomes y of the specimen; three images side by side fit in.
    let turn = UnitQuaternion::from_scaled_axis(Vector3::z() * std::f64::consts::FRAC_PI_2);
    let cut = Cut {
        thickness_nm: 40.0,
        size_nm: [300.0, 200.0],
        specimen_from_network: turn,
        centre: Point3::new(0.0, 10.0, 0.0),
        spacing_nm: 2.0,
    };
    let foil = foil_from_network(&network, &cut).unwrap();
    let total = length_nm(&foil.dislocations);
    // Lines at x = -100, 0, 100, each 200 long.
    assert_relative_eq!(total, 600.0, epsilon = 1e-6);
    for line in &foil.dislocations {
        assert_relative_eq!(line.burgers_nm.unwrap(), Vector3::new(0.0, 1.0, 0.0), epsilon = 1e-12);
        assert_relative_eq!(line.plane_normal.unwrap(), Vector3::z(), epsilon = 1e-12);
        for point in &line.points {
            assert_relative_eq!(point.x, (point.x / 100.0).round() * 100.0, epsilon = 1e-9);
            assert_relative_eq!(point.z, 10.0, epsilon = 1e-9);
        }
        assert!(line.points[1].y > line.points[0].y, "the sense of the line turned with its Burgers vector");
    }
}

#[test]
fn a_slab_cuts_lines_at_its_surfaces() {
    let network = Network::parse(&junction(), &UNIT).unwrap();
    let cut = Cut { thickness_nm: 300.0, size_nm: [900.0; 2], ..Cut::default() };
    let foil = foil_from_network(&network, &cut).unwrap();
    // The arms climb 400 over a length of 500: from z = 50 to the surface at 150 they are 125 long.
    assert_eq!(foil.dislocations.len(), 5);
    assert_relative_eq!(length_nm(&foil.dislocations), 100.0 + 4.0 * 125.0, epsilon = 1e-6);
    let ends = foil.dislocations.iter().flat_map(|line| [line.points[0], line.points[line.points.len() - 1]]);
    assert_eq!(ends.filter(|end| end.z.abs() == 150.0).count(), 4);
}

#[test]
fn impossible_cuts_are_refused() {
    let network = Network::parse(&endless(), &UNIT).unwrap();
    let with = |edit: fn(&mut Cut)| {
        let mut cut = Cut { thickness_nm: 20.0, size_nm: [50.0; 2], ..Cut::default() };
        edit(&mut cut);
        foil_from_network(&network, &cut).unwrap_err()
    };
    assert!(matches!(with(|cut| cut.thickness_nm = f64::NAN), CutError::Value { name: "thickness", .. }));
    assert!(matches!(
        with(|cut| cut.centre.y = f64::INFINITY),
        CutError::Value { name: "centre y", positive: false, .. }
    ));
    assert!(matches!(with(|cut| cut.size_nm = [1e7; 2]), CutError::TooLarge { .. }));
    assert!(matches!(with(|cut| cut.spacing_nm = 1e-12), CutError::TooFine { .. }));
}

#[test]
fn broken_files_are_refused_with_the_reason() {
    let error = |text: String| Network::parse(&text, &UNIT).unwrap_err();
    let good = frank_read();
    assert!(matches!(
        error(good.replace("nodeCount =   3", "nodeCount =   4")),
        ParadisError::NodeCount { found: 3, .. }
    ));
    assert!(matches!(
        error(good.replace("    0,2 0.5 0.5 -0.5", "    0,9 0.5 0.5 -0.5")),
        ParadisError::MissingNode { .. }
    ));
    assert!(matches!(error(good.replace("0,2 400.0", "0,1 400.0")), ParadisError::Duplicate { .. }));
    assert!(matches!(error(good.replace("0,0 -0.5 -0.5 0.5", "0,0 -0.5 0.5 0.5")), ParadisError::Burgers { .. }));
    assert!(matches!(error(good.replace("0,0 -0.5 -0.5 0.5", "0,2 -0.5 -0.5 0.5")), ParadisError::NotMutual { .. }));
    assert!(
        matches!(error(good.replace("-400.0", "NaN")), ParadisError::Syntax { problem, .. } if problem.contains("NaN"))
    );
    assert!(matches!(error(good.replace("-400.0", "-900.0")), ParadisError::Wrap { axis: 'x', .. }));
    assert!(matches!(error(good.replace("-400.0", "-1e9")), ParadisError::FarOutside { .. }));
    assert!(matches!(error(good.replace("Version =   4", "Version =   3")), ParadisError::Version { .. }));
    assert!(matches!(error(good.replace("Segments =   1", "Segments =   2")), ParadisError::Segments { .. }));
    assert!(matches!(error(good.replace("minCoordinates", "minimum")), ParadisError::Syntax { .. }));
    assert!(matches!(error(header(0.0, 0)), ParadisError::Box { .. }));
    assert!(matches!(error(good.replace("nodeCount", "burgMag = 2.5\nnodeCount")), ParadisError::Unit { .. }));
    let cut_off = &good[..good.len() - 9];
    let message = error(cut_off.to_owned()).to_string();
    assert!(message.contains("cut off") && message.starts_with("line 40"), "{message}");
    // Without periodicity a long arm is simply long.
    let long = good.replace("-400.0", "-900.0");
    assert!(Network::parse(&long, &ReadOptions { periodic: false, ..UNIT }).is_ok());
}

#[test]
fn two_segments_between_the_same_nodes_are_both_kept() {
    let text = header(100.0, 2)
        + "0,0 0 0 0 2 0\n 0,1 1 0 0\n 0 0 1\n 0,1 -1 0 0\n 0 0 1\n0,1 30 0 0 2 0\n 0,0 1 0 0\n 0 0 1\n 0,0 -1 0 0\n 0 0 1\n";
    let network = Network::parse(&text, &UNIT).unwrap();
    assert_eq!(network.segments, 2);
    let lines = network.lines();
    assert_eq!((lines.len(), lines[0].closed, lines[0].points.len()), (1, true, 2));
    assert_relative_eq!(length_nm(&network.lines_in_box()), 60.0, epsilon = 1e-9);
}

/// Networks from published simulations, where they are at hand: number of nodes and segments, and the balance of all nodes.
#[test]
fn published_networks_balance_and_keep_their_length() {
    let shared = std::env::var("TILTLINE_SHARED").unwrap_or_else(|_| "../../../shared".to_owned());
    for (name, nodes) in
        [("Ta.data", 264), ("copper_x8.data", 274), ("frank_read_src.data", 3), ("form_binaryjunc.data", 6)]
    {
        let path = Path::new(&shared).join("data/geometry").join(name);
        let Ok(text) = std::fs::read_to_string(&path) else {
            std::io::Write::write_all(&mut std::io::stderr(), format!("skipped: no {}\n", path.display()).as_bytes())
                .unwrap();
            continue;
        };
        let network = Network::parse(&text, &UNIT).unwrap();
        assert_eq!(network.nodes.len(), nodes);
        assert_eq!(2 * network.segments, network.nodes.iter().map(|node| node.arms.len()).sum::<usize>());
        for (index, node) in network.nodes.iter().enumerate().filter(|(_, node)| node.arms.len() > 1) {
            // Files are written with eight digits or more.
            assert!(network.burgers_sum_nm(index).norm() < 1e-6, "{name} {}", node.tag);
        }
        let lines = network.lines();
        assert_relative_eq!(length_nm(&lines), network.length_nm(), max_relative = 1e-9);
        assert_relative_eq!(length_nm(&network.lines_in_box()), network.length_nm(), max_relative = 1e-9);
        // A foil as large as the box holds it all, whatever its place.
        let size = network.size_nm();
        let cut = Cut {
            thickness_nm: size.z,
            size_nm: [size.x, size.y],
            centre: network.low + size * 0.3,
            spacing_nm: 0.001 * size.x,
            ..Cut::default()
        };
        let foil = foil_from_network(&network, &cut).unwrap();
        // Resampling cuts corners, by less than a thousandth here.
        assert_relative_eq!(length_nm(&foil.dislocations), network.length_nm(), max_relative = 2e-3);
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 400, failure_persistence: None, ..ProptestConfig::default() })]

    /// Whatever is done to the text, it is read or refused; what is read can be used.
    #[test]
    fn mutated_text_never_panics(
        which in 0usize..3,
        edits in prop::collection::vec((any::<prop::sample::Index>(), 0usize..12), 1..6),
    ) {
        let mut text: Vec<u8> = [frank_read(), junction(), endless()][which].clone().into_bytes();
        for (at, kind) in edits {
            if text.is_empty() { break; }
            let at = at.index(text.len());
            match kind {
                0 => { text.remove(at); }
                1 => text.truncate(at),
                2 => text.insert(at, b','),
                3 => text.insert(at, b'-'),
                4 => text.insert(at, b'='),
                5 => text.insert(at, b'['),
                6 => text.splice(at..at, *b"e300").for_each(drop),
                7 => text.splice(at..at, *b" NaN ").for_each(drop),
                8 => { let tail = text[at..].to_vec(); text.extend(tail); }
                9 => text.insert(at, b'9'),
                10 => text[at] = b'0',
                _ => text[at] = 0xff,
            }
        }
        let text = String::from_utf8_lossy(&text);
        for periodic in [true, false] {
            if let Ok(network) = Network::parse(&text, &ReadOptions { periodic, ..UNIT }) {
                prop_assert!(network.length_nm().is_finite());
                prop_assert!(length_nm(&network.lines_in_box()).is_finite());
                let _ = foil_from_network(&network, &Cut::default());
            }
        }
    }
}
