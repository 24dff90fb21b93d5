//! Random foils: curves in 3D with Burgers vectors and slip planes, drawn from a seed.
//!
//! [`random_foil`] draws a foil, a crystal in it and its active slip planes, and lets features grow (one file a kind:
//! [`threading`], [`glide`], [`loops`], [`pairs`], [`network`], [`arrays`], [`tangle`]) until the asked length of line per
//! volume is reached. Features are made in an endless foil and then cut by its surfaces, by the window around the field of view
//! and, in lamellar foils, by boundaries: no line ends anywhere else but in a node, where Burgers vectors sum to zero.
//!
//! Lengths in nm, in the untilted specimen frame of [`Foil`]. The same settings and random numbers give the same foil;
//! nothing here runs in parallel, so threads are for different foils.

pub mod arrays;
pub mod crystal;
pub mod feature;
pub mod glide;
pub mod loops;
pub mod network;
pub mod pairs;
pub mod polyline;
pub mod seed;
pub mod settings;
pub mod site;
pub mod tangle;
pub mod threading;
mod turn;
pub mod validate;

use rand::RngExt;
use rand_pcg::Pcg64;

pub use crystal::{Crystal, Lattice, SlipSystem};
pub use feature::Feature;
pub use seed::{Split, geometry_rng, geometry_seed};
pub use settings::{FoilSettings, Range, Weight};
pub use validate::FoilSettingsError;

use crate::geometry::{Point3, Vector3};
use crate::simulate::foil::{Dislocation, Foil};
use polyline::HalfSpace;
use site::{Site, chance, direction};

/// A foil with what it was grown from.
#[derive(Clone, Debug, PartialEq)]
pub struct FoilSample {
    /// The foil.
    pub foil: Foil,
    /// Boundaries in it, in order along their common normal: each the plane `normal . p = offset`. Empty without lamellae.
    pub boundaries: Vec<HalfSpace>,
    /// The crystal before the first boundary, between the first two, ..., after the last: one more than boundaries.
    pub crystals: Vec<Crystal>,
}

/// A random foil.
///
/// The length of line in the field over its volume comes within 15 percent of the density drawn from the settings, or within
/// one feature of it where that is only a few lines.
///
/// # Panics
/// Where the settings do not pass [`FoilSettings::validate`]: settings that come from a user are validated first.
pub fn random_foil(settings: &FoilSettings, rng: &mut Pcg64) -> Foil {
    sample_foil(settings, rng).foil
}

/// A random foil with its crystals (for the choice of g) and its boundaries (which an image shows too).
///
/// # Panics
/// As [`random_foil`].
pub fn sample_foil(settings: &FoilSettings, rng: &mut Pcg64) -> FoilSample {
    if let Err(error) = settings.validate() {
        panic!("foil settings are validated before a foil is drawn: {error}");
    }
    let Some(direction_deg) = settings.main_direction_deg else { return grown(settings, rng) };
    // The corners of the field must still be filled when the foil is turned by an eighth of a circle.
    let wider = FoilSettings { margin: settings.margin.max(TURNED_MARGIN), ..settings.clone() };
    let mut sample = grown(&wider, rng);
    turn::turn_to(&mut sample, direction_deg.sample(rng).to_radians());
    sample
}

/// Margin of foils that are turned: the corners of the field are 0.71 of its side from its centre.
const TURNED_MARGIN: f64 = 0.3;

fn grown(settings: &FoilSettings, rng: &mut Pcg64) -> FoilSample {
    let mut growth = Growth::start(settings, rng);
    growth.fill(rng);
    FoilSample {
        foil: Foil {
            thickness_nm: growth.thickness_nm,
            size_nm: [growth.field_nm; 2],
            dislocations: growth.dislocations,
        },
        boundaries: growth.boundaries,
        crystals: growth.grains.into_iter().map(|grain| grain.crystal).collect(),
    }
}

/// Greatest half extent of the window around the field: the field is a square of `size_nm`, and lines are cut at this
/// distance from its centre along x and y.
pub fn half_window_nm(settings: &FoilSettings, field_nm: f64) -> f64 {
    field_nm * (0.5 + settings.margin)
}

/// Pieces shorter than this, cut off at both ends, are left out, nm.
const SHORTEST_PIECE_NM: f64 = 3.0;
/// A feature may overfill the foil by this share of the length asked for.
const TOLERANCE: f64 = 0.1;
/// Features in a row that may fail to fit before the foil counts as full.
const PATIENCE: usize = 16;

/// A crystal and its active slip systems.
struct Grain {
    crystal: Crystal,
    systems: Vec<SlipSystem>,
}

/// A foil being filled.
struct Growth<'a> {
    settings: &'a FoilSettings,
    thickness_nm: f64,
    field_nm: f64,
    wanted_nm: f64,
    window: [HalfSpace; 6],
    boundaries: Vec<HalfSpace>,
    grains: Vec<Grain>,
    weights: Vec<(Feature, f64)>,
    centres: Vec<Point3>,
    dislocations: Vec<Dislocation>,
}

impl<'a> Growth<'a> {
    fn start(settings: &'a FoilSettings, rng: &mut Pcg64) -> Self {
        let field_nm = settings.field_nm.sample_log(rng);
        let thickness_nm = settings.thickness_nm.sample(rng);
        // 1 m^-2 is 1e-18 nm^-2.
        let density_per_nm2 = settings.density_per_m2.sample_log(rng) * 1e-18;
        let wanted_nm = (density_per_nm2 * field_nm * field_nm * thickness_nm)
            .clamp(settings.field_lengths.low * field_nm, settings.field_lengths.high * field_nm);
        let half = half_window_nm(settings, field_nm);
        let corner = Point3::new(half, half, 0.5 * thickness_nm);
        let lattice = settings.lattices[rng.random_range(0..settings.lattices.len())];
        let mut crystal = Crystal::random(lattice, rng);
        if let Some(range) = settings.axis_tilt_deg {
            let (sin, cos) = range.sample(rng).to_radians().sin_cos();
            let axis = site::azimuth(rng) * sin + Vector3::z() * cos;
            crystal = crystal.aligned(&crystal.axis(), &axis, rng.random_range(0.0..std::f64::consts::TAU));
        }
        let (boundaries, crystals) = if chance(settings.lamellar, rng) {
            lamellae(settings, crystal, half * 2f64.sqrt() + thickness_nm, rng)
        } else {
            (Vec::new(), vec![crystal])
        };
        let wall = boundaries.first().map(|wall| wall.normal);
        let grains = crystals
            .into_iter()
            .map(|crystal| Grain { crystal, systems: active_systems(settings, &crystal, wall, rng) });
        Self {
            settings,
            thickness_nm,
            field_nm,
            wanted_nm,
            window: polyline::box_region(-corner, corner),
            boundaries,
            grains: grains.collect(),
            weights: settings
                .features
                .iter()
                .map(|w| (w.feature, w.weight * rng.random::<f64>().powf(settings.variety)))
                .collect(),
            centres: Vec::new(),
            dislocations: Vec::new(),
        }
    }

    /// Lets features grow until the wanted length is in the field.
    fn fill(&mut self, rng: &mut Pcg64) {
        let mut length_nm = 0.0;
        let mut best: Option<(f64, Vec<Dislocation>)> = None;
        let mut failures = 0;
        while length_nm < self.wanted_nm * (1.0 - TOLERANCE) && failures < PATIENCE {
            let budget_nm = self.wanted_nm - length_nm;
            let (centre, lines) = self.feature(budget_nm, rng);
            let added_nm = self.length_in_field(&lines);
            if added_nm <= 0.0 {
                failures += 1;
            } else if added_nm <= budget_nm + TOLERANCE * self.wanted_nm {
                length_nm += added_nm;
                self.centres.push(centre);
                self.dislocations.extend(resample(lines, self.settings.spacing_nm));
                (best, failures) = (None, 0);
            } else {
                failures += 1;
                if best.as_ref().is_none_or(|(least, _)| added_nm < *least) {
                    best = Some((added_nm, lines));
                }
            }
        }
        // Nothing fits any more: the shortest that came up, if that is nearer to the mark than the foil is now.
        if let Some((added_nm, lines)) = best {
            let missing_nm = self.wanted_nm - length_nm;
            if added_nm - missing_nm < missing_nm || self.dislocations.is_empty() {
                self.dislocations.extend(resample(lines, self.settings.spacing_nm));
            }
        }
    }

    /// One feature somewhere, cut to the foil.
    fn feature(&self, budget_nm: f64, rng: &mut Pcg64) -> (Point3, Vec<Dislocation>) {
        let feature = self.draw_feature(rng);
        let mut centre = self.draw_centre(rng);
        let clings = matches!(feature, Feature::Tangle | Feature::Net | Feature::Pair | Feature::Dipole);
        let mut boundary = None;
        if !self.boundaries.is_empty() && clings && chance(self.settings.lamellae.at_boundary, rng) {
            let wall = self.boundaries[rng.random_range(0..self.boundaries.len())];
            let level = Vector3::new(wall.normal.x, wall.normal.y, 0.0);
            // Straight across to the boundary at the same depth; steep boundaries only are lamellae, so level is not zero.
            centre -= level * (wall.outside_by(&centre) / level.norm_squared().max(1e-6));
            boundary = Some(wall.normal.cross(&Vector3::z()).normalize());
        }
        let lamella = self.boundaries.iter().filter(|wall| wall.outside_by(&centre) > 0.0).count();
        let grain = &self.grains[lamella];
        let site = Site {
            thickness_nm: self.thickness_nm,
            window_nm: self.field_nm * (1.0 + 2.0 * self.settings.margin),
            centre,
            boundary,
            crystal: &grain.crystal,
            systems: &grain.systems,
            budget_nm,
            // Shapes are smooth at this scale: two steps of the final spacing.
            spacing_nm: 2.0 * self.settings.spacing_nm,
        };
        let lines = grow(feature, self.settings, &site, rng);
        let mut region = self.window.to_vec();
        if boundary.is_none() && chance(self.settings.lamellae.confined, rng) {
            region.extend(self.boundaries.get(lamella));
            if let Some(wall) = lamella.checked_sub(1).map(|before| self.boundaries[before]) {
                region.push(HalfSpace { normal: -wall.normal, offset: -wall.offset });
            }
        }
        (centre, clip(&lines, &region, self.thickness_nm))
    }

    fn draw_feature(&self, rng: &mut Pcg64) -> Feature {
        let total: f64 = self.weights.iter().map(|(_, weight)| weight).sum();
        let mut left = total * rng.random::<f64>();
        for &(feature, weight) in &self.weights {
            left -= weight;
            if left < 0.0 {
                return feature;
            }
        }
        let possible = self.weights.iter().rev().find(|(_, weight)| *weight > 0.0);
        possible.unwrap_or(&self.weights[self.weights.len() - 1]).0
    }

    fn draw_centre(&self, rng: &mut Pcg64) -> Point3 {
        let half = half_window_nm(self.settings, self.field_nm);
        let depth = 0.5 * self.thickness_nm;
        if !self.centres.is_empty() && chance(self.settings.clustering, rng) {
            let near = self.centres[rng.random_range(0..self.centres.len())];
            let mut centre = near + direction(rng) * (0.15 * self.field_nm * rng.random::<f64>());
            centre.z = centre.z.clamp(-depth, depth);
            return centre;
        }
        Point3::new(
            half * rng.random_range(-1.0..1.0),
            half * rng.random_range(-1.0..1.0),
            depth * rng.random_range(-1.0..1.0),
        )
    }

    fn length_in_field(&self, lines: &[Dislocation]) -> f64 {
        lines.iter().map(|line| length_in_field_nm(line, [self.field_nm; 2])).sum()
    }
}

/// Length of the part of a line in the field of view, a rectangle of `size_nm` around the axis, nm.
pub fn length_in_field_nm(line: &Dislocation, size_nm: [f64; 2]) -> f64 {
    let corner = Point3::new(0.5 * size_nm[0], 0.5 * size_nm[1], f64::INFINITY);
    polyline::length_inside(&line.points, line.closed, &polyline::box_region(-corner, corner)[..4])
}

/// Boundaries that fill a radius around the origin, and the crystals between them: variants turned by multiples of 60 degrees
/// about the normal of a close-packed plane, which is the boundary plane of all of them (as in lamellar TiAl, and of
/// twins in cubic metals).
fn lamellae(
    settings: &FoilSettings,
    crystal: Crystal,
    radius_nm: f64,
    rng: &mut Pcg64,
) -> (Vec<HalfSpace>, Vec<Crystal>) {
    let (sin, cos) = settings.lamellae.inclination_deg.sample(rng).to_radians().sin_cos();
    let normal = site::azimuth(rng) * sin + Vector3::z() * cos;
    let packed = crystal.slip_systems()[0].normal;
    let variant = |rng: &mut Pcg64| {
        let turn = std::f64::consts::FRAC_PI_3 * f64::from(rng.random_range(0..6));
        let first = crystal.aligned(&packed, &normal, 0.0);
        first.aligned(&normal, &normal, turn)
    };
    let mut boundaries = Vec::new();
    let mut crystals = vec![variant(rng)];
    let mut offset = -radius_nm + settings.lamellae.width_nm.sample_log(rng) * rng.random::<f64>();
    while offset < radius_nm {
        boundaries.push(HalfSpace { normal, offset });
        crystals.push(variant(rng));
        offset += settings.lamellae.width_nm.sample_log(rng);
    }
    (boundaries, crystals)
}

/// The slip systems of a few planes of the crystal. The flatter a plane lies, the more of it is in the foil and the likelier it
/// is drawn, but planes within 8 degrees of level carry no line through the foil. Most lamellae keep slip off the planes
/// parallel to their boundaries.
fn active_systems(
    settings: &FoilSettings,
    crystal: &Crystal,
    boundary: Option<Vector3>,
    rng: &mut Pcg64,
) -> Vec<SlipSystem> {
    let same = |one: &Vector3, two: &Vector3| one.dot(two).abs() > 1.0 - 1e-9;
    let all = crystal.slip_systems();
    let mut planes: Vec<Vector3> = Vec::new();
    for system in &all {
        if !planes.iter().any(|plane| same(plane, &system.normal)) {
            planes.push(system.normal);
        }
    }
    let avoided = boundary.filter(|_| chance(0.75, rng));
    let suits = |plane: &Vector3| plane.z.abs() < 0.99 && !avoided.is_some_and(|boundary| same(&boundary, plane));
    let suitable: Vec<Vector3> = planes.iter().copied().filter(suits).collect();
    let mut pool = if suitable.is_empty() { planes } else { suitable };
    let count = (settings.active_planes.sample(rng).round() as usize).clamp(1, pool.len());
    let mut chosen: Vec<Vector3> = Vec::new();
    while chosen.len() < count {
        // The width of a plane in the foil is the thickness over the sine of its dip.
        let widths = pool.iter().map(|plane| 1.0 / plane.xy().norm().max(0.14));
        let mut left = widths.clone().sum::<f64>() * rng.random::<f64>();
        let drawn = widths
            .take_while(|width| {
                left -= width;
                left >= 0.0
            })
            .count();
        chosen.push(pool.swap_remove(drawn.min(pool.len() - 1)));
    }
    all.iter().filter(|system| chosen.iter().any(|plane| same(plane, &system.normal))).copied().collect()
}

/// The uncut lines of one feature.
fn grow(feature: Feature, settings: &FoilSettings, site: &Site, rng: &mut Pcg64) -> Vec<Dislocation> {
    let mut lines = match feature {
        Feature::Threading => threading::threading(&settings.threading, site, rng),
        Feature::Helix => threading::helix(&settings.threading, site, rng),
        Feature::Bowed => glide::bowed(&settings.glide, site, rng),
        Feature::HalfLoop => glide::half_loop(&settings.glide, site, rng),
        Feature::Trailing => glide::trailing(&settings.glide, site, rng),
        Feature::Source => glide::source(&settings.glide, site, rng),
        Feature::Straight => glide::straight(&settings.glide, site, rng),
        Feature::Zigzag => glide::zigzag(&settings.glide, site, rng),
        Feature::Loop => loops::loops(&settings.loops, site, rng),
        Feature::Pair => pairs::pair(settings, site, rng),
        Feature::Dipole => pairs::dipole(settings, site, rng),
        Feature::Junction => network::junction(&settings.network, site, rng),
        Feature::Net => network::net(&settings.network, site, rng),
        Feature::PileUp => arrays::pile_up(settings, site, rng),
        Feature::SlipBand => arrays::slip_band(settings, site, rng),
        Feature::Misfit => arrays::misfit(&settings.arrays, site, rng),
        Feature::Tangle => tangle::tangle(&settings.tangle, site, rng),
    };
    // The ends of networks are nodes; all others must come out at a surface.
    if !matches!(feature, Feature::Junction | Feature::Net) {
        let window = 0.5 * site.window_nm;
        for line in lines.iter_mut().filter(|line| !line.closed) {
            let out = |end: Option<&Point3>| end.is_none_or(|end| end.x.abs() > window || end.y.abs() > window);
            // Lines that leave by the window need no surface.
            if !(out(line.points.first()) && out(line.points.last())) {
                site.run_out(&mut line.points, line.plane_normal);
            }
        }
    }
    lines
}

/// The parts of lines in a region; points as given, and where cut.
pub(super) fn clip(lines: &[Dislocation], region: &[HalfSpace], thickness_nm: f64) -> Vec<Dislocation> {
    let mut pieces = Vec::new();
    for line in lines {
        for mut piece in polyline::clip(&line.points, line.closed, region) {
            if piece.cut == [true, true] && polyline::length(&piece.points, false) < SHORTEST_PIECE_NM {
                continue;
            }
            // Takes the rounding of the cut back out: ends at a surface lie on it exactly.
            let half = 0.5 * thickness_nm;
            let last = piece.points.len() - 1;
            for (index, point) in piece.points.iter_mut().enumerate() {
                let at_end = index == 0 || index == last;
                if point.z.abs() > half || (at_end && half - point.z.abs() < 1e-9 * thickness_nm) {
                    point.z = half.copysign(point.z);
                }
            }
            pieces.push(Dislocation { points: piece.points, closed: piece.closed, ..*line });
        }
    }
    pieces
}

/// The same lines with points at most `spacing_nm` apart; lines of no length are left out.
pub(super) fn resample(lines: Vec<Dislocation>, spacing_nm: f64) -> Vec<Dislocation> {
    let resampled = lines.into_iter().map(|line| {
        let points = polyline::resample(&line.points, line.closed, spacing_nm);
        Dislocation { points, ..line }
    });
    resampled.filter(|line| line.points.len() > 1).collect()
}

#[cfg(test)]
mod tests;
