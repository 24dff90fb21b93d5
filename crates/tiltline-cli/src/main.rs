//! The command `tiltline`.
fn main() {}
