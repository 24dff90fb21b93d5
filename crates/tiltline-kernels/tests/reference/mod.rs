//! The definitions, written as loops in `f64`, and what tests share.
#![allow(dead_code, missing_docs)]

use tiltline_kernels::{Conv, Instructions, Path, ShapeError, TransposedConv};

/// A convolution or a transposed one, by its definition. `size` is the input's.
#[derive(Clone, Copy, Debug)]
pub struct Definition {
    pub batch: usize,
    pub inputs: usize,
    pub outputs: usize,
    pub size: [usize; 3],
    pub kernel: [usize; 3],
    pub stride: usize,
    pub transposed: bool,
}

impl Definition {
    pub fn conv(
        kernel: [usize; 3],
        stride: usize,
        batch: usize,
        inputs: usize,
        outputs: usize,
        size: [usize; 3],
    ) -> Self {
        Self { batch, inputs, outputs, size, kernel, stride, transposed: false }
    }

    pub fn transposed(kernel: [usize; 3], batch: usize, inputs: usize, outputs: usize, size: [usize; 3]) -> Self {
        Self { batch, inputs, outputs, size, kernel, stride: 2, transposed: true }
    }

    fn stride(&self) -> [usize; 3] {
        self.kernel.map(|kernel| if kernel == 1 { 1 } else { self.stride })
    }

    /// 1 for three elements, 0 for one and two.
    fn padding(&self) -> [usize; 3] {
        self.kernel.map(|kernel| usize::from(kernel == 3))
    }

    pub fn output_size(&self) -> [usize; 3] {
        [0, 1, 2].map(|axis| {
            let (size, kernel) = (self.size[axis], self.kernel[axis]);
            let (stride, padding) = (self.stride()[axis], self.padding()[axis]);
            if self.transposed {
                // PyTorch's formula, output padding 1 where the kernel has three elements.
                (size - 1) * stride + kernel + usize::from(kernel == 3) - 2 * padding
            } else {
                (size + 2 * padding - kernel) / stride + 1
            }
        })
    }

    pub fn input_len(&self) -> usize {
        self.batch * self.inputs * self.size.iter().product::<usize>()
    }

    pub fn output_len(&self) -> usize {
        self.batch * self.outputs * self.output_size().iter().product::<usize>()
    }

    pub fn weight_len(&self) -> usize {
        self.inputs * self.outputs * self.kernel.iter().product::<usize>()
    }

    /// Calls `term(input index, weight index, output index)` for every product in the definition.
    pub fn for_each_term(&self, mut term: impl FnMut(usize, usize, usize)) {
        let (stride, padding, out) = (self.stride(), self.padding(), self.output_size());
        let index = |size: [usize; 3], plane: usize, at: [usize; 3]| {
            ((plane * size[0] + at[0]) * size[1] + at[1]) * size[2] + at[2]
        };
        // The side that strides are counted on.
        let (coarse, fine) = if self.transposed { (self.size, out) } else { (out, self.size) };
        for n in 0..self.batch {
            for o in 0..self.outputs {
                for i in 0..self.inputs {
                    for q in places(coarse) {
                        for k in places(self.kernel) {
                            let at =
                                [0, 1, 2].map(|axis| (stride[axis] * q[axis] + k[axis]).wrapping_sub(padding[axis]));
                            if (0..3).any(|axis| at[axis] >= fine[axis]) {
                                continue;
                            }
                            let (input, output, pair) = if self.transposed {
                                (q, at, i * self.outputs + o)
                            } else {
                                (at, q, o * self.inputs + i)
                            };
                            term(
                                index(self.size, n * self.inputs + i, input),
                                index(self.kernel, pair, k),
                                index(out, n * self.outputs + o, output),
                            );
                        }
                    }
                }
            }
        }
    }

    pub fn forward(&self, x: &[f32], w: &[f32]) -> Sums {
        let mut sums = Sums::new(self.output_len());
        self.for_each_term(|xi, wi, yi| sums.add(yi, x[xi], w[wi]));
        sums
    }

    pub fn input_gradient(&self, w: &[f32], gy: &[f32]) -> Sums {
        let mut sums = Sums::new(self.input_len());
        self.for_each_term(|xi, wi, yi| sums.add(xi, gy[yi], w[wi]));
        sums
    }

    pub fn weight_gradient(&self, x: &[f32], gy: &[f32]) -> Sums {
        let mut sums = Sums::new(self.weight_len());
        self.for_each_term(|xi, wi, yi| sums.add(wi, gy[yi], x[xi]));
        sums
    }

    pub fn channel_of_output(&self, index: usize) -> usize {
        index / self.output_size().iter().product::<usize>() % self.outputs
    }

    pub fn kernel_shape(&self) -> Result<Shape, ShapeError> {
        let Self { batch, inputs, outputs, size, kernel, stride, transposed } = *self;
        let [depth, rows, columns] = size;
        assert!(kernel[0] > 1 || depth == 1 || kernel == [1; 3]);
        Ok(match (kernel, transposed) {
            ([1, 1, 1], false) => Shape::Conv(Conv::pointwise(batch, inputs, outputs, depth * rows * columns)?),
            ([1, 3, 3], false) => Shape::Conv(Conv::plane(batch, inputs, outputs, [rows, columns], stride)?),
            ([3, 3, 3], false) => Shape::Conv(Conv::volume(batch, inputs, outputs, size, stride)?),
            ([1, 2, 2], true) => Shape::Transposed(TransposedConv::plane(batch, inputs, outputs, [rows, columns])?),
            ([3, 3, 3], true) => Shape::Transposed(TransposedConv::volume(batch, inputs, outputs, size)?),
            _ => panic!("no kernel for {self:?}"),
        })
    }
}

fn places(size: [usize; 3]) -> impl Iterator<Item = [usize; 3]> {
    (0..size.iter().product()).map(move |i| [i / (size[1] * size[2]), i / size[2] % size[1], i % size[2]])
}

pub enum Shape {
    Conv(Conv),
    Transposed(TransposedConv),
}

/// Calls a method that both kinds of convolution have.
#[macro_export]
macro_rules! on {
    ($shape:expr, $method:ident($($argument:expr),*)) => {
        match &$shape {
            $crate::reference::Shape::Conv(shape) => shape.$method($($argument),*),
            $crate::reference::Shape::Transposed(shape) => shape.$method($($argument),*),
        }
    };
}

/// Sums of products, and of their absolute values, by which rounding errors are measured.
pub struct Sums {
    pub values: Vec<f64>,
    pub magnitudes: Vec<f64>,
}

impl Sums {
    fn new(len: usize) -> Self {
        Self { values: vec![0.0; len], magnitudes: vec![0.0; len] }
    }

    pub fn add(&mut self, at: usize, a: f32, b: f32) {
        let product = f64::from(a) * f64::from(b);
        self.values[at] += product;
        self.magnitudes[at] += product.abs();
    }

    /// Rounding errors of `f32` are random, at most half an epsilon of a partial sum each; a few hundred of them add up to
    /// some ten halves at most, of the sum of magnitudes. A wrong term is off by far more than 16 epsilon.
    pub fn assert_close(&self, found: &[f32], what: &str) {
        assert_eq!(found.len(), self.values.len(), "{what}");
        for (i, &found) in found.iter().enumerate() {
            let tolerance = 16.0 * f64::from(f32::EPSILON) * self.magnitudes[i];
            let error = (f64::from(found) - self.values[i]).abs();
            assert!(
                error <= tolerance,
                "{what}: element {i} is {found}, not {} (tolerance {tolerance:e})",
                self.values[i]
            );
        }
    }
}

/// Numbers between -1 and 1 that look random and are the same everywhere (splitmix64).
pub fn noise(len: usize, seed: u64) -> Vec<f32> {
    let mut state = seed.wrapping_mul(0xd134_2543_de82_ef95);
    (0..len)
        .map(|_| {
            state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
            let mut z = state;
            z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
            z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
            ((z ^ (z >> 31)) >> 40) as f32 / (1 << 23) as f32 - 1.0
        })
        .collect()
}

pub fn dot(a: &[f32], b: &[f32]) -> f64 {
    assert_eq!(a.len(), b.len());
    a.iter().zip(b).map(|(&a, &b)| f64::from(a) * f64::from(b)).sum()
}

/// All paths of this machine; says which are absent.
pub fn paths() -> Vec<Path> {
    let present = |instructions| {
        let path = Path::forced(instructions);
        if path.is_none() {
            eprintln!("{instructions} is absent from this machine: not tested");
        }
        path
    };
    Instructions::ALL.into_iter().filter_map(present).collect()
}

/// Runs work on so many threads.
pub fn on_threads<T: Send>(threads: usize, work: impl FnOnce() -> T + Send) -> T {
    rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a small pool").install(work)
}
