//! The TIFF reader: directories, metadata and every page.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| tiltline::io::exercise::tiff(bytes));
