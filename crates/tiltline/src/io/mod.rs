//! Readers of micrographs and tilt series: one file a format.
