//! Where networks run.

use burn::tensor::Device;

/// A place that networks can run on.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Place {
    /// The processor, with our own kernels.
    #[default]
    Cpu,
    /// A graphics card, through Vulkan, Metal or DirectX; needs the feature `wgpu`.
    Wgpu,
    /// An Nvidia card; needs the feature `cuda`. Untested.
    Cuda,
}

/// A place this program was built without.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("this program was built without {feature}; install it again with `--features {feature}`, or use the CPU")]
pub struct NotBuilt {
    /// The feature.
    pub feature: &'static str,
}

impl Place {
    /// The device.
    ///
    /// # Errors
    /// Where the program was built without it: nothing falls back silently.
    pub fn device(self) -> Result<Device, NotBuilt> {
        match self {
            Place::Cpu => Ok(Device::flex()),
            #[cfg(feature = "wgpu")]
            Place::Wgpu => Ok(Device::wgpu(burn::tensor::DeviceKind::DefaultDevice)),
            #[cfg(not(feature = "wgpu"))]
            Place::Wgpu => Err(NotBuilt { feature: "wgpu" }),
            #[cfg(feature = "cuda")]
            Place::Cuda => Ok(Device::cuda(0)),
            #[cfg(not(feature = "cuda"))]
            Place::Cuda => Err(NotBuilt { feature: "cuda" }),
        }
    }
}

/// To be called once when a program that uses networks on the CPU starts.
pub fn prepare_memory() {
    tiltline_kernels::keep_freed_memory();
}
