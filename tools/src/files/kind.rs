//! The kind of a file by its content: its magic number, or its first lines if it is text.

use std::fs::File;
use std::io::{self, Read};
use std::path::Path;

use palpate_core::format::MAGIC;
use palpate_precompute::space::Store;

/// Bytes read from a file: enough for a whole scene and for the header of any table.
const HEAD: u64 = 1 << 20;

const SQLITE: &[u8] = b"SQLite format 3\0";
const PNG: &[u8] = b"\x89PNG\r\n\x1a\n";
const MCAP: &[u8] = b"\x89MCAP0\r\n";

/// The kinds of files that commands read and write, and other kinds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum FileKind {
    /// No bytes.
    Empty,
    /// A blob of this program.
    Blob,
    /// A configuration space of this program, whole or damaged.
    Space,
    /// An SQLite database of another program.
    Database,
    /// A recorded session.
    Recording,
    /// A still picture.
    Png,
    /// A drawing, as this program writes it.
    Svg,
    /// An animated picture.
    Gif,
    /// Comma-separated values under a header of names, as this program writes them.
    Table,
    /// An unstructured grid for ParaView.
    Vtu,
    /// A list of grids for ParaView.
    Pvd,
    /// A web page.
    Html,
    /// JSON.
    Json,
    /// A scene, a device profile or another TOML file.
    Toml,
    /// A mesh in a format that has a magic word.
    Mesh,
    /// Any other text.
    Text,
    /// Any other bytes.
    Other,
}

impl FileKind {
    /// The kind of the file at `path`, which must be a regular file.
    pub(crate) fn of(path: &Path) -> io::Result<Self> {
        let mut head = Vec::new();
        File::open(path)?.take(HEAD).read_to_end(&mut head)?;
        let is_database = head.starts_with(SQLITE);
        match Self::of_bytes(&head) {
            // The magic number of a space may be damaged.
            Self::Other if Store::is_space(path)? => Ok(Self::Space),
            Self::Other if is_database => Ok(Self::Database),
            kind => Ok(kind),
        }
    }

    fn of_bytes(head: &[u8]) -> Self {
        let begins = |magic: &[u8]| head.starts_with(magic);
        if head.is_empty() {
            Self::Empty
        } else if begins(&MAGIC) {
            Self::Blob
        } else if begins(PNG) {
            Self::Png
        } else if begins(MCAP) {
            Self::Recording
        } else if begins(b"GIF87a") || begins(b"GIF89a") {
            Self::Gif
        } else {
            text_of(head).map_or(Self::Other, Self::of_text)
        }
    }

    fn of_text(text: &str) -> Self {
        let text = text.trim_start();
        let begins =
            |word: &str| text.get(..word.len()).is_some_and(|start| start.eq_ignore_ascii_case(word));
        if begins("$MeshFormat") || begins("$Comments") || begins("# vtk DataFile") {
            Self::Mesh
        } else if begins("<!DOCTYPE html") || begins("<html") {
            Self::Html
        } else if begins("<svg") {
            Self::Svg
        } else if text.contains("<VTKFile") {
            if text.contains("type=\"Collection\"") { Self::Pvd } else { Self::Vtu }
        } else if text.lines().next().is_some_and(is_header) {
            Self::Table
        } else if toml::from_str::<toml::Table>(text).is_ok_and(|table| !table.is_empty()) {
            Self::Toml
        } else if begins("{") || begins("[") {
            Self::Json
        } else {
            Self::Text
        }
    }

    /// The name for messages, with its article.
    pub(crate) const fn name(self) -> &'static str {
        match self {
            Self::Empty => "an empty file",
            Self::Blob => "a blob",
            Self::Space => "a space",
            Self::Database => "a database of another program",
            Self::Recording => "a recording (MCAP)",
            Self::Png => "a picture (PNG)",
            Self::Svg => "a drawing (SVG)",
            Self::Gif => "a film (GIF)",
            Self::Table => "a table (CSV)",
            Self::Vtu => "a grid (VTU)",
            Self::Pvd => "a series of grids (PVD)",
            Self::Html => "a web page",
            Self::Json => "a JSON file",
            Self::Toml => "a scene or another TOML file",
            Self::Mesh => "a mesh",
            Self::Text => "a text file",
            Self::Other => "a file of another kind",
        }
    }
}

/// The bytes as UTF-8 text, without an incomplete last character; `None` if they are not text.
fn text_of(head: &[u8]) -> Option<&str> {
    match std::str::from_utf8(head) {
        Ok(text) => Some(text),
        Err(error) if error.error_len().is_none() => std::str::from_utf8(&head[..error.valid_up_to()]).ok(),
        Err(_) => None,
    }
    .filter(|text| !text.contains('\0'))
}

/// Whether a line is a header as Palpate writes it: at least two names of letters, digits, `_` and `-`.
fn is_header(line: &str) -> bool {
    let is_name = |cell: &str| {
        cell.starts_with(|c: char| c.is_ascii_alphabetic())
            && cell.chars().all(|c| c.is_ascii_alphanumeric() || c == '_' || c == '-')
    };
    line.contains(',') && line.split(',').all(is_name)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn kind(bytes: &[u8]) -> FileKind {
        FileKind::of_bytes(bytes)
    }

    #[test]
    fn the_content_decides() {
        let assets = Path::new(env!("CARGO_MANIFEST_DIR")).join("../assets");
        let bundled = |name: &str| FileKind::of(&assets.join(name)).expect("a bundled file");
        assert_eq!(bundled("liver-small.toml"), FileKind::Toml);
        assert_eq!(bundled("liver-small.msh"), FileKind::Mesh);
        let golden =
            Path::new(env!("CARGO_MANIFEST_DIR")).join("../firmware-like-core/golden/organ-514.blob");
        assert_eq!(FileKind::of(&golden).expect("a bundled file"), FileKind::Blob);
        let expected: [(&[u8], FileKind); 15] = [
            (b"", FileKind::Empty),
            (b"x_m,y_m,z_m\n0,0,0\n", FileKind::Table),
            (b"active,rbf-linear_fx_n\n", FileKind::Table),
            (b"Hello, world\n", FileKind::Text),
            (b"1.0,2.0,3.0\n", FileKind::Text),
            (b"{\"F1\": [0, 1]}", FileKind::Json),
            (b"[\n  {\"a\": 1}\n]", FileKind::Json),
            (b"[mesh]\nfile = \"a.msh\"\n", FileKind::Toml),
            (b"# only a remark\n", FileKind::Text),
            (b"GIF89a\x00\x01", FileKind::Gif),
            (b"<svg xmlns=\"http://www.w3.org/2000/svg\">", FileKind::Svg),
            (b"<!DOCTYPE html>\n<html>", FileKind::Html),
            (b"<?xml version=\"1.0\"?>\n<VTKFile type=\"Collection\">", FileKind::Pvd),
            (b"<?xml version=\"1.0\"?>\n<VTKFile type=\"UnstructuredGrid\">", FileKind::Vtu),
            (b"\x00\x01\x02", FileKind::Other),
        ];
        for (bytes, expected) in expected {
            assert_eq!(kind(bytes), expected, "{}", String::from_utf8_lossy(bytes));
        }
    }

    /// The head of a long file may end inside a character.
    #[test]
    fn a_character_cut_in_two_is_still_text() {
        let text = "a_m,b_m\n\u{b5}".as_bytes();
        assert_eq!(kind(&text[..text.len() - 1]), FileKind::Table);
        assert_eq!(kind(b"a_m,b_m\n\xff\xff"), FileKind::Other);
    }
}
