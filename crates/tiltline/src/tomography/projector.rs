//! The projector of a slab and its exact adjoint: distance-driven (De Man and Basu, Phys. Med. Biol. 49, 2004).
//!
//! A voxel's shadow at tilt a is a box of width m = max(|cos a|, |sin a|) about `x = X cos a + Z sin a`; a detector bin takes the
//! share of the box that lies over it. Every voxel gives its whole value to the bins, and every ray takes the length of its path
//! through each layer (1 / m), so that a constant volume gives smooth projections and constant views a smooth volume: neither
//! direction has the ripple that interpolating projectors have near 45 degrees.
//!
//! All weights are the same for every y, and a slab holds [`LANES`] rows of y side by side: the inner loops multiply and add whole
//! rows of lanes. Positions are fixed-point numbers of 32 fractional bits, stepped without rounding, so that both directions
//! see the same weights.

use super::Geometry;

/// Rows of y that are worked on together.
pub const LANES: usize = 32;

/// One voxel, or one bin of a view, for each row of a slab.
pub type Lanes = [f32; LANES];

/// Layers of the volume that stay in the second-level cache while all views take them.
const BLOCK: usize = 32;
/// Fractional bits of positions.
const FRACTION_BITS: u32 = 32;

/// Projects slabs of volumes `[z][x]` on to views `[view][column]`, each element being [`Lanes`].
#[derive(Clone, Debug)]
pub struct Projector {
    views: Vec<View>,
    width: usize,
    depth: usize,
}

/// What one view needs, positions in fixed point.
#[derive(Clone, Copy, Debug)]
struct View {
    /// Whether rays cross a layer of constant z (else one of constant x) at each step.
    through_z: bool,
    /// Lower edge of a ray in the layer, counted along it from the edge of its first voxel: `first + u * per_bin + n * per_layer`.
    first: i64,
    per_bin: i64,
    per_layer: i64,
    /// Width of a ray in a layer, `1 / m`.
    ray_width: f32,
    /// Lower edge of a voxel's shadow, counted from the edge of the first bin: `shadow + x * per_x + z * per_z`.
    shadow: i64,
    per_x: i64,
    per_z: i64,
}

impl View {
    fn new(tilt_rad: f64, geometry: &Geometry) -> Self {
        let (sin, cos) = tilt_rad.sin_cos();
        let fixed = |value: f64| (value * (1_u64 << FRACTION_BITS) as f64).round() as i64;
        let axis = geometry.axis_column;
        let middle = geometry.middle_layer();
        let through_z = cos.abs() >= sin.abs();
        let (m, along) = if through_z { (cos.abs(), cos) } else { (sin.abs(), sin) };
        // Ray u meets layer z (or x) where x = (u - axis - Z sin) / cos + axis (or z = (u - axis - X cos) / sin + middle).
        let (origin, across) = if through_z { (axis, sin) } else { (middle, cos) };
        let layer_origin = if through_z { middle } else { axis };
        let centre = origin - (axis - layer_origin * across) / along;
        Self {
            through_z,
            first: fixed(centre - 0.5 / m + 0.5),
            per_bin: fixed(1.0 / along),
            per_layer: fixed(-across / along),
            ray_width: (1.0 / m) as f32,
            shadow: fixed(axis - axis * cos - middle * sin - 0.5 * m + 0.5),
            per_x: fixed(cos),
            per_z: fixed(sin),
        }
    }
}

/// Whole part of a position and the fraction above it.
#[inline(always)]
fn split(position: i64) -> (i64, f32) {
    // A multiple of 2^-32 below 1, rounded to the nearest float.
    let fraction = (position & ((1 << FRACTION_BITS) - 1)) as f32 * (1.0 / (1_u64 << FRACTION_BITS) as f32);
    (position >> FRACTION_BITS, fraction)
}

#[inline(always)]
fn add_three(sum: &mut Lanes, values: [&Lanes; 3], weights: [f32; 3]) {
    for lane in 0..LANES {
        sum[lane] += weights[0] * values[0][lane] + weights[1] * values[1][lane] + weights[2] * values[2][lane];
    }
}

#[inline(always)]
fn add_two(sum: &mut Lanes, values: [&Lanes; 2], weights: [f32; 2]) {
    for lane in 0..LANES {
        sum[lane] += weights[0] * values[0][lane] + weights[1] * values[1][lane];
    }
}

impl Projector {
    /// The projector of a geometry.
    pub fn new(geometry: &Geometry) -> Self {
        let views = geometry.tilts_rad.iter().map(|tilt| View::new(*tilt, geometry)).collect();
        Self { views, width: geometry.width, depth: geometry.depth }
    }

    /// Elements of a slab of the volume, `depth * width`.
    pub fn volume_len(&self) -> usize {
        self.width * self.depth
    }

    /// Elements of a slab of the views, `views * width`.
    pub fn views_len(&self) -> usize {
        self.views.len() * self.width
    }

    /// Replaces the views by the projections of a slab.
    pub fn project(&self, volume: &[Lanes], views: &mut [Lanes]) {
        assert_eq!(volume.len(), self.volume_len(), "a slab has depth * width elements");
        assert_eq!(views.len(), self.views_len(), "a slab of views has views * width elements");
        views.fill([0.0; LANES]);
        for through_z in [true, false] {
            let layers = if through_z { self.depth } else { self.width };
            for first in (0..layers).step_by(BLOCK) {
                let block = first..(first + BLOCK).min(layers);
                for (view, bins) in self.views.iter().zip(views.chunks_exact_mut(self.width)) {
                    if view.through_z == through_z {
                        self.project_block(view, volume, block.clone(), bins);
                    }
                }
            }
        }
    }

    fn project_block(&self, view: &View, volume: &[Lanes], block: std::ops::Range<usize>, bins: &mut [Lanes]) {
        // Along a layer, and from one layer to the next.
        let (count, along, across) =
            if view.through_z { (self.depth, 1, self.width) } else { (self.width, self.width, 1) };
        debug_assert!(block.end <= count);
        let length = if view.through_z { self.width } else { self.depth };
        let start = view.first + block.start as i64 * view.per_layer;
        for (u, sum) in bins.iter_mut().enumerate() {
            let mut own = *sum;
            let mut position = start + u as i64 * view.per_bin;
            for layer in block.clone() {
                let (first, fraction) = split(position);
                position += view.per_layer;
                let low = 1.0 - fraction;
                let rest = view.ray_width - low;
                let middle = rest.min(1.0);
                let weights = [low, middle, rest - middle];
                if first >= 0 && (first as usize) + 2 < length {
                    let at = layer * across + first as usize * along;
                    add_three(&mut own, [&volume[at], &volume[at + along], &volume[at + 2 * along]], weights);
                } else {
                    for (tap, weight) in weights.into_iter().enumerate() {
                        let inside = usize::try_from(first + tap as i64).ok().filter(|index| *index < length);
                        if let Some(index) = inside {
                            let value = &volume[layer * across + index * along];
                            own.iter_mut().zip(value).for_each(|(own, value)| *own += weight * value);
                        }
                    }
                }
            }
            *sum = own;
        }
    }

    /// The adjoint: gives each voxel's sum over the views to `take(index, sum)`, in the order of the volume.
    #[inline]
    pub fn back_project(&self, views: &[Lanes], mut take: impl FnMut(usize, &Lanes)) {
        assert_eq!(views.len(), self.views_len(), "a slab of views has views * width elements");
        let mut starts: Vec<(i64, i64, f32)> = Vec::with_capacity(self.views.len());
        for z in 0..self.depth {
            starts.clear();
            // In units of the shadow's width.
            starts.extend(
                self.views.iter().map(|view| (view.shadow + z as i64 * view.per_z, view.per_x, view.ray_width)),
            );
            for x in 0..self.width {
                let mut sum = [0.0; LANES];
                for ((start, per_x, inverse), bins) in starts.iter().zip(views.chunks_exact(self.width)) {
                    let (first, fraction) = split(start + x as i64 * per_x);
                    let low = ((1.0 - fraction) * inverse).min(1.0);
                    let weights = [low, 1.0 - low];
                    if first >= 0 && (first as usize) + 1 < bins.len() {
                        let first = first as usize;
                        add_two(&mut sum, [&bins[first], &bins[first + 1]], weights);
                    } else {
                        for (tap, weight) in weights.into_iter().enumerate() {
                            let inside = usize::try_from(first + tap as i64).ok().and_then(|index| bins.get(index));
                            if let Some(value) = inside {
                                sum.iter_mut().zip(value).for_each(|(sum, value)| *sum += weight * value);
                            }
                        }
                    }
                }
                take(z * self.width + x, &sum);
            }
        }
    }
}
