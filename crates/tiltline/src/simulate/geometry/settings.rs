//! What random foils are made of: sizes, densities, crystals, and how often each kind of line occurs.
//!
//! Lengths in nm, densities in m^-2, angles in degrees (this is an edge: the values come from TOML files). Every field has
//! a default; the presets change what sets a material apart.

use rand::RngExt;
use rand_pcg::Pcg64;
use serde::{Deserialize, Serialize};

use super::crystal::Lattice;
use super::feature::Feature;

/// A range of values, written `[low, high]`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(from = "[f64; 2]", into = "[f64; 2]")]
pub struct Range {
    /// Smallest value.
    pub low: f64,
    /// Largest value.
    pub high: f64,
}

impl From<[f64; 2]> for Range {
    fn from([low, high]: [f64; 2]) -> Self {
        Self { low, high }
    }
}

impl From<Range> for [f64; 2] {
    fn from(range: Range) -> Self {
        [range.low, range.high]
    }
}

impl Range {
    /// From `low` to `high`.
    pub const fn new(low: f64, high: f64) -> Self {
        Self { low, high }
    }

    /// One value only.
    pub const fn exactly(value: f64) -> Self {
        Self { low: value, high: value }
    }

    /// A value, all alike.
    pub fn sample(&self, rng: &mut Pcg64) -> f64 {
        self.low + (self.high - self.low) * rng.random::<f64>()
    }

    /// A value, each factor alike: for what spans decades. Both limits are positive.
    pub fn sample_log(&self, rng: &mut Pcg64) -> f64 {
        // The clamp takes the rounding of exp and ln back out: `exactly` stays exact.
        (self.low.ln() + (self.high / self.low).ln() * rng.random::<f64>()).exp().clamp(self.low, self.high)
    }
}

/// How often a kind of line is begun.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Weight {
    /// The kind.
    pub feature: Feature,
    /// Its weight among the others, not negative.
    pub weight: f64,
}

fn weights(pairs: &[(Feature, f64)]) -> Vec<Weight> {
    pairs.iter().map(|&(feature, weight)| Weight { feature, weight }).collect()
}

/// Settings of random foils.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FoilSettings {
    /// Side of the square field of view; drawn with all factors alike.
    pub field_nm: Range,
    /// Thickness of the foil.
    pub thickness_nm: Range,
    /// Length of line per volume in the field, in m^-2; drawn with all factors alike.
    pub density_per_m2: Range,
    /// Bounds of the length of line in the field over the side of the field, which win over the density: an image shows something, and
    /// no more than can be told apart.
    pub field_lengths: Range,
    /// Greatest distance of neighbouring points of a line. A third of a pixel is enough.
    pub spacing_nm: f64,
    /// Lines go on beyond the field by this share of its side on each side. The field stays filled up to a tilt of
    /// acos(1 / (1 + 2 margin)): 40 degrees with 0.15.
    pub margin: f64,
    /// One of these is drawn for each foil.
    pub lattices: Vec<Lattice>,
    /// Angle of the c axis to the beam; any orientation if absent.
    pub axis_tilt_deg: Option<Range>,
    /// Turns the whole foil about the beam so that the main direction of its lines, in projection, makes this angle with the rows;
    /// any direction if absent.
    pub main_direction_deg: Option<Range>,
    /// Number of slip planes that are active in one crystal.
    pub active_planes: Range,
    /// Kinds of lines and their weights.
    pub features: Vec<Weight>,
    /// How much the weights vary from foil to foil: each is multiplied by `u^variety` with u in (0, 1); 0 keeps them.
    pub variety: f64,
    /// Probability that a feature grows near an earlier one.
    pub clustering: f64,
    /// Lamellae (twins, boundaries) with lines between and along them, in this share of the foils.
    pub lamellar: f64,
    /// How lamellae lie, where there are some.
    pub lamellae: LamellaSettings,
    /// Threading lines and helices.
    pub threading: ThreadingSettings,
    /// Lines on slip planes.
    pub glide: GlideSettings,
    /// Closed loops.
    pub loops: LoopSettings,
    /// Pairs and dipoles.
    pub pairs: PairSettings,
    /// Junctions and nets.
    pub network: NetworkSettings,
    /// Pile-ups, slip bands and misfit arrays.
    pub arrays: ArraySettings,
    /// Tangles.
    pub tangle: TangleSettings,
}

/// Parallel boundaries.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LamellaSettings {
    /// Distance of neighbouring boundaries; drawn anew for each lamella, all factors alike.
    pub width_nm: Range,
    /// Angle of the boundaries' normal to the beam: 90 is edge on.
    pub inclination_deg: Range,
    /// Probability that a line stays within its lamella and ends at the boundaries.
    pub confined: f64,
    /// Probability that a tangle, net or pair grows at a boundary.
    pub at_boundary: f64,
}

impl Default for LamellaSettings {
    fn default() -> Self {
        Self {
            width_nm: Range::new(120.0, 1200.0),
            inclination_deg: Range::new(60.0, 90.0),
            confined: 0.8,
            at_boundary: 0.6,
        }
    }
}

/// Threading lines and helices.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ThreadingSettings {
    /// Angle of the line to the beam.
    pub inclination_deg: Range,
    /// Probability that the line follows the c axis instead.
    pub along_axis: f64,
    /// Scatter about the c axis.
    pub scatter_deg: f64,
    /// Sag over length.
    pub sag: Range,
    /// Radius of helices.
    pub helix_radius_nm: Range,
    /// Pitch over radius of helices.
    pub helix_pitch: Range,
}

impl Default for ThreadingSettings {
    fn default() -> Self {
        Self {
            inclination_deg: Range::new(5.0, 80.0),
            along_axis: 0.0,
            scatter_deg: 8.0,
            sag: Range::new(-0.15, 0.15),
            helix_radius_nm: Range::new(8.0, 45.0),
            helix_pitch: Range::new(1.5, 6.0),
        }
    }
}

/// Lines on slip planes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct GlideSettings {
    /// How far a line bows out, over half the width of its plane in the foil.
    pub bow: Range,
    /// Slope of the chord against the steepest way down the plane.
    pub skew: Range,
    /// Exponent of the bow: 2 a parabola, larger a flat front with bent ends.
    pub flatness: Range,
    /// Amplitude of the waviness.
    pub wave_amplitude_nm: Range,
    /// Its wavelength.
    pub wave_length_nm: Range,
    /// Probability that a line is made of straight facets.
    pub kinked: f64,
    /// Length of facets.
    pub facet_nm: Range,
    /// Length of trailing segments.
    pub trail_nm: Range,
    /// Distance of the pinning points of sources.
    pub source_nm: Range,
    /// Half the distance of the ends of half-loops.
    pub half_loop_nm: Range,
    /// Length of the straight parts of zig-zags.
    pub zigzag_nm: Range,
    /// Angle between the parts of a zig-zag and its mean direction.
    pub zigzag_deg: Range,
}

impl Default for GlideSettings {
    fn default() -> Self {
        Self {
            bow: Range::new(-1.2, 1.2),
            skew: Range::new(-1.2, 1.2),
            flatness: Range::new(1.7, 4.5),
            wave_amplitude_nm: Range::new(0.0, 10.0),
            wave_length_nm: Range::new(100.0, 500.0),
            kinked: 0.15,
            facet_nm: Range::new(25.0, 110.0),
            trail_nm: Range::new(200.0, 1800.0),
            source_nm: Range::new(80.0, 500.0),
            half_loop_nm: Range::new(30.0, 300.0),
            zigzag_nm: Range::new(30.0, 160.0),
            zigzag_deg: Range::new(15.0, 45.0),
        }
    }
}

/// Closed loops.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LoopSettings {
    /// Radius; drawn with all factors alike.
    pub radius_nm: Range,
    /// Long over short axis.
    pub aspect: Range,
    /// Probability of a hexagonal loop.
    pub hexagonal: f64,
    /// Number of loops that lie together.
    pub together: Range,
}

impl Default for LoopSettings {
    fn default() -> Self {
        Self {
            radius_nm: Range::new(10.0, 200.0),
            aspect: Range::new(1.0, 2.5),
            hexagonal: 0.25,
            together: Range::new(1.0, 4.0),
        }
    }
}

/// Pairs and dipoles.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PairSettings {
    /// Distance of the two lines in their plane; drawn with all factors alike.
    pub distance_nm: Range,
    /// Distance of the two planes of a dipole.
    pub height_nm: Range,
    /// How much the distance varies along the lines, as a share of it.
    pub unevenness: Range,
}

impl Default for PairSettings {
    fn default() -> Self {
        Self { distance_nm: Range::new(6.0, 60.0), height_nm: Range::new(2.0, 25.0), unevenness: Range::new(0.0, 0.3) }
    }
}

/// Junctions and nets.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct NetworkSettings {
    /// Length of the junction between its two nodes.
    pub junction_nm: Range,
    /// Sag over length of the arms.
    pub sag: Range,
    /// Length of the edges of a net; drawn with all factors alike.
    pub mesh_nm: Range,
    /// Extent of a net along its boundary.
    pub extent_nm: Range,
    /// Displacement of the nodes, as a share of the mesh; below 0.5.
    pub irregularity: Range,
    /// Stretch of the mesh in one direction.
    pub stretch: Range,
}

impl Default for NetworkSettings {
    fn default() -> Self {
        Self {
            junction_nm: Range::new(30.0, 300.0),
            sag: Range::new(-0.25, 0.25),
            mesh_nm: Range::new(35.0, 350.0),
            extent_nm: Range::new(200.0, 1500.0),
            irregularity: Range::new(0.02, 0.4),
            stretch: Range::new(1.0, 2.5),
        }
    }
}

/// Rows of similar lines.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ArraySettings {
    /// Number of lines in a pile-up or slip band.
    pub lines: Range,
    /// Distance of the first two lines of a pile-up; it grows away from the obstacle.
    pub first_gap_nm: Range,
    /// Mean distance of the lines of a slip band.
    pub band_gap_nm: Range,
    /// How much one line differs from the next, as a share of its bow.
    pub variation: Range,
    /// Distance of the lines of a misfit array.
    pub misfit_gap_nm: Range,
    /// Number of lines in each set of a misfit array.
    pub misfit_lines: Range,
}

impl Default for ArraySettings {
    fn default() -> Self {
        Self {
            lines: Range::new(3.0, 16.0),
            first_gap_nm: Range::new(6.0, 40.0),
            band_gap_nm: Range::new(30.0, 250.0),
            variation: Range::new(0.03, 0.35),
            misfit_gap_nm: Range::new(30.0, 220.0),
            misfit_lines: Range::new(3.0, 14.0),
        }
    }
}

/// Tangles.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TangleSettings {
    /// Number of lines.
    pub lines: Range,
    /// Half the width of the tangle.
    pub radius_nm: Range,
    /// Length over width, along the boundary where there is one.
    pub elongation: Range,
    /// Length over which a line forgets its direction.
    pub persistence_nm: Range,
    /// Length of each line within the tangle, over the length of the tangle.
    pub winding: Range,
}

impl Default for TangleSettings {
    fn default() -> Self {
        Self {
            lines: Range::new(3.0, 14.0),
            radius_nm: Range::new(40.0, 260.0),
            elongation: Range::new(1.0, 6.0),
            persistence_nm: Range::new(25.0, 120.0),
            winding: Range::new(0.7, 2.5),
        }
    }
}

impl Default for FoilSettings {
    /// The same as [`FoilSettings::mixed`].
    fn default() -> Self {
        Self {
            field_nm: Range::new(500.0, 4000.0),
            thickness_nm: Range::new(60.0, 400.0),
            density_per_m2: Range::new(2e12, 1e14),
            field_lengths: Range::new(4.0, 30.0),
            spacing_nm: 2.0,
            margin: 0.15,
            lattices: vec![Lattice::ALUMINIUM, Lattice::CANTOR, Lattice::IRON, Lattice::GAN, Lattice::TIAL],
            axis_tilt_deg: None,
            main_direction_deg: None,
            active_planes: Range::new(1.0, 4.0),
            features: Feature::ALL.map(|feature| Weight { feature, weight: 1.0 }).to_vec(),
            variety: 2.0,
            clustering: 0.3,
            lamellar: 0.3,
            lamellae: LamellaSettings::default(),
            threading: ThreadingSettings::default(),
            glide: GlideSettings::default(),
            loops: LoopSettings::default(),
            pairs: PairSettings::default(),
            network: NetworkSettings::default(),
            arrays: ArraySettings::default(),
            tangle: TangleSettings::default(),
        }
    }
}

impl FoilSettings {
    /// Gallium nitride: threading lines, straight or slightly bowed, rows of bowed lines on one plane, some half-loops.
    pub fn gan() -> Self {
        use Feature::*;
        Self {
            field_nm: Range::new(800.0, 4000.0),
            thickness_nm: Range::new(100.0, 400.0),
            density_per_m2: Range::new(5e12, 6e13),
            field_lengths: Range::new(4.0, 18.0),
            lattices: vec![Lattice::GAN],
            axis_tilt_deg: Some(Range::new(15.0, 78.0)),
            active_planes: Range::new(1.0, 3.0),
            features: weights(&[
                (Threading, 3.0),
                (Bowed, 2.5),
                (HalfLoop, 1.5),
                (SlipBand, 1.5),
                (Straight, 0.5),
                (Loop, 0.4),
                (Zigzag, 0.4),
                (Pair, 0.3),
                (Misfit, 0.3),
                (Junction, 0.3),
            ]),
            variety: 1.0,
            lamellar: 0.05,
            threading: ThreadingSettings {
                along_axis: 0.6,
                inclination_deg: Range::new(15.0, 80.0),
                sag: Range::new(-0.1, 0.1),
                ..ThreadingSettings::default()
            },
            glide: GlideSettings { bow: Range::new(-1.0, 1.0), ..GlideSettings::default() },
            ..Self::default()
        }
    }

    /// Lamellar titanium aluminide: long bowed lines and pairs between lamella boundaries, tangles along them.
    pub fn tial() -> Self {
        use Feature::*;
        Self {
            field_nm: Range::new(1200.0, 4000.0),
            thickness_nm: Range::new(80.0, 300.0),
            density_per_m2: Range::new(1e13, 9e13),
            field_lengths: Range::new(9.0, 35.0),
            lattices: vec![Lattice::TIAL],
            features: weights(&[
                (Trailing, 4.0),
                (Bowed, 2.5),
                (Pair, 2.0),
                (Tangle, 2.0),
                (Dipole, 0.7),
                (Straight, 0.4),
                (Source, 1.0),
                (Junction, 0.8),
                (Zigzag, 0.5),
                (HalfLoop, 0.6),
                (Loop, 1.0),
                (Net, 0.3),
            ]),
            variety: 0.7,
            lamellar: 0.9,
            loops: LoopSettings { radius_nm: Range::new(30.0, 900.0), ..LoopSettings::default() },
            tangle: TangleSettings {
                radius_nm: Range::new(25.0, 120.0),
                elongation: Range::new(2.0, 9.0),
                ..TangleSettings::default()
            },
            glide: GlideSettings {
                trail_nm: Range::new(300.0, 2500.0),
                wave_amplitude_nm: Range::new(2.0, 20.0),
                wave_length_nm: Range::new(150.0, 700.0),
                ..GlideSettings::default()
            },
            ..Self::default()
        }
    }

    /// The Cantor alloy: pile-ups and planar slip on few planes, networks, dense.
    pub fn cantor() -> Self {
        use Feature::*;
        Self {
            field_nm: Range::new(500.0, 2500.0),
            thickness_nm: Range::new(60.0, 250.0),
            density_per_m2: Range::new(2e13, 1e14),
            field_lengths: Range::new(7.0, 40.0),
            lattices: vec![Lattice::CANTOR],
            active_planes: Range::new(1.0, 3.0),
            features: weights(&[
                (PileUp, 3.0),
                (SlipBand, 2.0),
                (Junction, 1.5),
                (Net, 1.2),
                (Bowed, 1.0),
                (Trailing, 1.0),
                (Straight, 0.4),
                (Tangle, 0.6),
                (Dipole, 0.6),
                (Loop, 0.4),
            ]),
            variety: 0.7,
            lamellar: 0.15,
            ..Self::default()
        }
    }

    /// Everything, in widely varying proportions.
    pub fn mixed() -> Self {
        Self::default()
    }

    /// The same settings with one kind of line only, in foils without lamellae.
    pub fn only(self, feature: Feature) -> Self {
        Self { features: weights(&[(feature, 1.0)]), lamellar: 0.0, ..self }
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;

    use super::*;

    #[test]
    fn settings_survive_toml_and_unknown_keys_do_not() {
        for settings in [FoilSettings::gan(), FoilSettings::tial(), FoilSettings::cantor(), FoilSettings::mixed()] {
            let text = toml::to_string(&settings).expect("settings are plain data");
            assert_eq!(toml::from_str::<FoilSettings>(&text).expect("own output"), settings);
        }
        assert!(toml::from_str::<FoilSettings>("densty = [1.0, 2.0]").is_err());
        let partial: FoilSettings = toml::from_str("thickness_nm = [100.0, 120.0]\nglide.kinked = 0.5").expect("valid");
        assert_eq!((partial.thickness_nm, partial.glide.kinked), (Range::new(100.0, 120.0), 0.5));
    }

    #[test]
    fn samples_stay_within_their_range() {
        let mut rng = Pcg64::seed_from_u64(1);
        let range = Range::new(1e12, 1e14);
        assert!((0..1000).map(|_| range.sample_log(&mut rng)).all(|value| (1e12..=1e14).contains(&value)));
        assert_eq!(Range::exactly(3e13).sample_log(&mut rng), 3e13);
        assert_eq!(Range::exactly(-2.5).sample(&mut rng), -2.5);
    }
}
