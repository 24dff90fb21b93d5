//! Opening a file: the `path#k` notation, its length, its hash.

use std::fs::File;
use std::io::{BufReader, Cursor, ErrorKind, Read, Seek, SeekFrom};
use std::path::Path;

use sha2::{Digest, Sha256};

use super::ReadError;
use super::samples::reserve;

/// A file of which nothing is known yet but its name and its length.
#[derive(Debug)]
pub struct Input<R> {
    /// The bytes.
    pub reader: R,
    /// The name that messages use.
    pub path: String,
    /// Number of bytes.
    pub length: u64,
}

impl Input<BufReader<File>> {
    /// Opens a file that is there, is a file, and is not empty.
    pub fn open(path: &str) -> Result<Self, ReadError> {
        let metadata = std::fs::metadata(path).map_err(|source| io_error(path, source))?;
        if !metadata.is_file() {
            let what = if metadata.is_dir() { "folder" } else { "device" };
            return Err(ReadError::NotAFile { path: path.to_owned(), what });
        }
        if metadata.len() == 0 {
            return Err(ReadError::Empty { path: path.to_owned() });
        }
        let file = File::open(path).map_err(|source| io_error(path, source))?;
        Ok(Self { reader: BufReader::new(file), path: path.to_owned(), length: metadata.len() })
    }
}

impl<'a> Input<Cursor<&'a [u8]>> {
    /// A file in memory; `name` stands for its path in messages.
    pub fn in_memory(name: &str, bytes: &'a [u8]) -> Self {
        Self { reader: Cursor::new(bytes), path: name.to_owned(), length: bytes.len() as u64 }
    }
}

impl<R: Read + Seek> Input<R> {
    /// Up to `count` bytes from `offset` on: fewer where the file ends.
    pub fn bytes_at(&mut self, offset: u64, count: u64) -> Result<Vec<u8>, ReadError> {
        let held = count.min(self.length.saturating_sub(offset));
        let mut bytes = reserve(&self.path, held)?;
        let read = self
            .reader
            .seek(SeekFrom::Start(offset))
            .and_then(|_| self.reader.by_ref().take(held).read_to_end(&mut bytes));
        read.map_err(|source| io_error(&self.path, source))?;
        Ok(bytes)
    }
}

/// Splits `path#k` into the path and page k; a file that is itself named with `#` is taken whole.
pub(super) fn split_spec(spec: &str) -> Result<(String, Option<usize>), ReadError> {
    let Some((path, page)) = spec.rsplit_once('#') else { return Ok((spec.to_owned(), None)) };
    if path.is_empty() || Path::new(spec).exists() {
        return Ok((spec.to_owned(), None));
    }
    match page.parse() {
        Ok(page) => Ok((path.to_owned(), Some(page))),
        Err(_) if Path::new(path).exists() => Err(ReadError::BadPage { spec: spec.to_owned(), page: page.to_owned() }),
        Err(_) => Ok((spec.to_owned(), None)),
    }
}

/// SHA-256 of a whole file in hexadecimal.
pub(super) fn sha256(path: &str) -> Result<String, ReadError> {
    let mut file = File::open(path).map_err(|source| io_error(path, source))?;
    let mut hasher = Sha256::new();
    let mut buffer = vec![0; 1 << 20];
    loop {
        match file.read(&mut buffer) {
            Ok(0) => break,
            Ok(count) => hasher.update(&buffer[..count]),
            Err(error) if error.kind() == ErrorKind::Interrupted => {}
            Err(source) => return Err(io_error(path, source)),
        }
    }
    Ok(hasher.finalize().iter().map(|byte| format!("{byte:02x}")).collect())
}

pub(super) fn io_error(path: &str, source: std::io::Error) -> ReadError {
    let path = path.to_owned();
    match source.kind() {
        ErrorKind::NotFound => ReadError::Missing { path },
        _ => ReadError::Io { path, source },
    }
}
