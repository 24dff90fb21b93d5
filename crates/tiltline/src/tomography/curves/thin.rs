//! Thinning of volumes to curves, keeping their topology: components (26-connected), holes and cavities (6-connected background).
//!
//! Simple points are removed, told by the two topological numbers of Bertrand and Malandain (Pattern Recognition Letters 15, 1994):
//! one 26-component of the object among the 26 neighbours, and one 6-component of the background among the 18 neighbours that
//! touches the point. Borders of the six directions are peeled in turn and each point is looked at again before it goes, as by
//! Lee, Kashyap and Chu (CVGIP 56, 1994). A point with one neighbour is the end of a curve, and stays.

use ndarray::Array3;

/// Offsets of a point's neighbourhood, the point itself being number 13: `(z, y, x)` from -1 to 1.
const fn offset(index: usize) -> [isize; 3] {
    [(index / 9) as isize - 1, (index / 3 % 3) as isize - 1, (index % 3) as isize - 1]
}

const CENTRE: usize = 13;
/// Opposite sides follow each other, which keeps the skeleton in the middle.
const SIDES: [usize; 6] = [4, 22, 10, 16, 12, 14];

/// Tables of the neighbourhood, a bit a place.
struct Tables {
    near26: [u32; 27],
    /// Neighbours by faces, within the 18 neighbours of the centre.
    near6: [u32; 27],
    faces: u32,
    eighteen: u32,
}

impl Tables {
    fn new() -> Self {
        let mut tables = Self { near26: [0; 27], near6: [0; 27], faces: 0, eighteen: 0 };
        let steps = |a: usize, b: usize| {
            let (a, b) = (offset(a), offset(b));
            [0, 1, 2].map(|axis| a[axis].abs_diff(b[axis]))
        };
        for place in (0..27).filter(|place| *place != CENTRE) {
            let from_centre: usize = steps(place, CENTRE).iter().sum();
            tables.faces |= u32::from(from_centre == 1) << place;
            tables.eighteen |= u32::from(from_centre <= 2) << place;
            for other in (0..27).filter(|other| *other != CENTRE && *other != place) {
                let apart = steps(place, other);
                tables.near26[place] |= u32::from(apart.iter().all(|step| *step <= 1)) << other;
                tables.near6[place] |= u32::from(apart.iter().sum::<usize>() == 1) << other;
            }
        }
        for near in &mut tables.near6 {
            *near &= tables.eighteen;
        }
        tables
    }

    /// Everything in `of` that is connected to its first place that is also in `seeds`.
    fn grown(of: u32, seeds: u32, near: &[u32; 27]) -> u32 {
        let start = of & seeds;
        let mut found = start & start.wrapping_neg();
        let mut open = found;
        while open != 0 {
            let place = open.trailing_zeros() as usize;
            open &= open - 1;
            let new = near[place] & of & !found;
            found |= new;
            open |= new;
        }
        found
    }

    /// Whether removing a point with these object neighbours changes no topology.
    fn is_simple(&self, object: u32) -> bool {
        if object == 0 || Self::grown(object, u32::MAX, &self.near26) != object {
            return false;
        }
        let background = !object & self.eighteen;
        let touching = background & self.faces;
        touching != 0 && Self::grown(background, self.faces, &self.near6) & self.faces == touching
    }
}

/// The mask in a frame of background, so that every point has its neighbours.
struct Framed {
    set: Vec<bool>,
    steps: [isize; 27],
}

impl Framed {
    fn neighbours(&self, at: usize) -> u32 {
        let mut bits = 0;
        for (place, step) in self.steps.iter().enumerate() {
            bits |= u32::from(self.set[at.wrapping_add_signed(*step)]) << place;
        }
        bits & !(1 << CENTRE)
    }
}

/// The curve skeleton of a mask `[z, y, x]`: the voxels that stay, in the order of the volume.
pub fn thin(mask: &Array3<bool>) -> Vec<[usize; 3]> {
    let (depth, rows, columns) = mask.dim();
    let (row, layer) = (columns + 2, (columns + 2) * (rows + 2));
    let mut framed = Framed {
        set: vec![false; layer * (depth + 2)],
        steps: std::array::from_fn(|place| {
            let [z, y, x] = offset(place);
            z * layer as isize + y * row as isize + x
        }),
    };
    let mut points = Vec::new();
    for ((z, y, x), _) in mask.indexed_iter().filter(|(_, set)| **set) {
        let at = (z + 1) * layer + (y + 1) * row + x + 1;
        framed.set[at] = true;
        points.push(at);
    }
    let tables = Tables::new();
    let removable = |framed: &Framed, at: usize| {
        let object = framed.neighbours(at);
        object.count_ones() > 1 && tables.is_simple(object)
    };
    // Points inside become part of the border as it recedes, so each pass looks at all that are left.
    loop {
        let before = points.len();
        for side in SIDES {
            let step = framed.steps[side];
            let border: Vec<usize> = points
                .iter()
                .copied()
                .filter(|at| !framed.set[at.wrapping_add_signed(step)] && removable(&framed, *at))
                .collect();
            for at in border {
                if removable(&framed, at) {
                    framed.set[at] = false;
                }
            }
            points.retain(|at| framed.set[*at]);
        }
        if points.len() == before {
            break;
        }
    }
    points.iter().map(|at| [at / layer - 1, at % layer / row - 1, at % row - 1]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};

    /// Number of connected parts of `value`, the outside joined to the background.
    fn parts(mask: &Array3<bool>, value: bool, faces_only: bool) -> usize {
        let (depth, rows, columns) = mask.dim();
        let mut left = Array3::from_shape_fn((depth + 2, rows + 2, columns + 2), |(z, y, x)| {
            let inside = (1..=depth).contains(&z) && (1..=rows).contains(&y) && (1..=columns).contains(&x);
            (inside && mask[[z - 1, y - 1, x - 1]]) == value
        });
        let all: Vec<_> = left.indexed_iter().map(|(at, _)| at).collect();
        let mut count = 0;
        for start in all {
            if !left[start] {
                continue;
            }
            count += 1;
            left[start] = false;
            let mut open = vec![start];
            while let Some((z, y, x)) = open.pop() {
                for place in 0..27 {
                    let [dz, dy, dx] = offset(place);
                    if faces_only && dz.abs() + dy.abs() + dx.abs() != 1 {
                        continue;
                    }
                    let next = (z.wrapping_add_signed(dz), y.wrapping_add_signed(dy), x.wrapping_add_signed(dx));
                    if let Some(set) = left.get_mut(next)
                        && *set
                    {
                        *set = false;
                        open.push(next);
                    }
                }
            }
        }
        count
    }

    /// Euler number of the union of closed unit cubes (26-connected object): vertices - edges + faces - cubes.
    fn euler(mask: &Array3<bool>) -> i64 {
        let (depth, rows, columns) = mask.dim();
        let mut cells = Array3::from_elem((2 * depth + 1, 2 * rows + 1, 2 * columns + 1), false);
        for ((z, y, x), _) in mask.indexed_iter().filter(|(_, set)| **set) {
            for place in 0..27 {
                let at = offset(place);
                let cell = [2 * z + 1, 2 * y + 1, 2 * x + 1];
                cells[[0, 1, 2].map(|axis| cell[axis].wrapping_add_signed(at[axis]))] = true;
            }
        }
        let signed = |((z, y, x), _): ((usize, usize, usize), &bool)| 1 - 2 * ((z % 2 + y % 2 + x % 2) as i64 % 2);
        cells.indexed_iter().filter(|(_, set)| **set).map(signed).sum()
    }

    fn skeleton(mask: &Array3<bool>) -> Array3<bool> {
        let mut skeleton = Array3::from_elem(mask.dim(), false);
        thin(mask).into_iter().for_each(|at| skeleton[at] = true);
        skeleton
    }

    /// Components, cavities and the Euler number (with them: tunnels) of blobs of every kind.
    #[test]
    fn thinning_keeps_the_topology_of_random_blobs_and_leaves_nothing_to_remove() {
        for seed in 0..10 {
            let mut rng = rand_pcg::Pcg64::seed_from_u64(seed);
            let noise = Array3::from_shape_simple_fn((14, 15, 16), || rng.random_range(-1.0..1.0_f32));
            let reach = seed as isize % 3;
            let mask = Array3::from_shape_fn(noise.dim(), |(z, y, x)| {
                let mut sum = 0.0;
                for dz in -reach..=reach {
                    for dy in -reach..=reach {
                        for dx in -reach..=reach {
                            let at = (z.wrapping_add_signed(dz), y.wrapping_add_signed(dy), x.wrapping_add_signed(dx));
                            sum += noise.get(at).copied().unwrap_or(0.0);
                        }
                    }
                }
                sum > 0.0
            });
            let thinned = skeleton(&mask);
            assert_eq!(parts(&mask, true, false), parts(&thinned, true, false), "components, seed {seed}");
            assert_eq!(parts(&mask, false, true), parts(&thinned, false, true), "cavities, seed {seed}");
            assert_eq!(euler(&mask), euler(&thinned), "Euler number, seed {seed}");
            assert!(thinned.iter().zip(&mask).all(|(thin, thick)| !thin || *thick));
            assert_eq!(skeleton(&thinned), thinned, "thinning twice changes nothing");
        }
    }

    #[test]
    fn a_rod_becomes_its_axis_and_a_torus_one_ring() {
        let rod = Array3::from_shape_fn((13, 13, 40), |(z, y, x)| {
            (z as f64 - 6.0).hypot(y as f64 - 6.0) <= 3.2 && (4..36).contains(&x)
        });
        let axis = thin(&rod);
        for x in 8..32 {
            let there: Vec<_> = axis.iter().filter(|at| at[2] == x).collect();
            assert_eq!(there.len(), 1);
            assert!(there[0][0].abs_diff(6) + there[0][1].abs_diff(6) <= 1);
        }
        let torus = Array3::from_shape_fn((9, 31, 31), |(z, y, x)| {
            let ring = (y as f64 - 15.0).hypot(x as f64 - 15.0) - 10.0;
            ring.hypot(z as f64 - 4.0) <= 2.6
        });
        let ring = skeleton(&torus);
        let framed = |[z, y, x]: [usize; 3]| {
            (0..27)
                .filter(|place| *place != CENTRE)
                .filter(|place| {
                    let [dz, dy, dx] = offset(*place);
                    let at = (z.wrapping_add_signed(dz), y.wrapping_add_signed(dy), x.wrapping_add_signed(dx));
                    ring.get(at).copied().unwrap_or(false)
                })
                .count()
        };
        let points = thin(&torus);
        assert!(points.len() > 50 && points.len() < 80);
        assert!(points.iter().filter(|at| framed(**at) != 2).count() <= 4, "a ring without ends");
    }
}
