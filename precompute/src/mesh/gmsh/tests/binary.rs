//! Binary files, written here from the text files of the other tests.

use std::str::FromStr;

use super::*;

/// Writes numbers in one byte order.
struct Writer {
    out: Vec<u8>,
    little: bool,
}

impl Writer {
    fn put<const N: usize>(&mut self, mut bytes: [u8; N]) {
        if !self.little {
            bytes.reverse();
        }
        self.out.extend(bytes);
    }

    fn ints(&mut self, words: &[&str]) {
        words.iter().for_each(|word| self.put(i32::from_str(word).expect("an integer").to_le_bytes()));
    }

    fn sizes(&mut self, words: &[&str]) {
        words.iter().for_each(|word| self.put(u64::from_str(word).expect("a size").to_le_bytes()));
    }

    fn reals(&mut self, words: &[&str]) {
        words.iter().for_each(|word| self.put(f64::from_str(word).expect("a number").to_le_bytes()));
    }

    /// An entity of version 4.1 with `reals` coordinates.
    fn entity(&mut self, words: &[&str], reals: usize) {
        let (groups, rest) = words[1 + reals..].split_first().expect("the number of groups");
        let (groups, boundary) = rest.split_at(groups.parse().expect("a count"));
        self.ints(&words[..1]);
        self.reals(&words[1..=reals]);
        self.sizes(&[&groups.len().to_string()]);
        self.ints(groups);
        if reals == 6 {
            self.sizes(&boundary[..1]);
            self.ints(&boundary[1..]);
        }
    }

    fn section(&mut self, name: &str, is_22: bool, lines: &[Vec<&str>]) {
        match (name, is_22) {
            ("Nodes", true) => lines[1..].iter().for_each(|words| {
                self.ints(&words[..1]);
                self.reals(&words[1..]);
            }),
            // The last two elements are of one kind and form a block.
            ("Elements", true) => (1..lines.len()).for_each(|at| {
                let words = &lines[at];
                let (is_last, is_joined) = (at == lines.len() - 1, lines.len() - 2 == at);
                if !is_last {
                    self.ints(&[words[1], if is_joined { "2" } else { "1" }, words[2]]);
                }
                self.ints(&words[..1]);
                self.ints(&words[3..]);
            }),
            ("Entities", _) => {
                self.sizes(&lines[0]);
                let points: usize = lines[0][0].parse().expect("a count");
                for (at, words) in lines[1..].iter().enumerate() {
                    self.entity(words, if at < points { 3 } else { 6 });
                }
            }
            (_, _) => {
                self.sizes(&lines[0]);
                let mut rest = &lines[1..];
                while let Some((block, after)) = rest.split_first() {
                    let n: usize = block[3].parse().expect("a count");
                    self.ints(&block[..3]);
                    self.sizes(&block[3..]);
                    after[..n].iter().for_each(|words| self.sizes(words));
                    let reals = if name == "Nodes" { n } else { 0 };
                    after[n..n + reals].iter().for_each(|words| self.reals(words));
                    rest = &after[n + reals..];
                }
            }
        }
    }
}

fn binary(text: &str, little: bool) -> Vec<u8> {
    let mut writer = Writer { out: Vec::new(), little };
    let is_22 = text.contains("2.2 0 8");
    let mut lines = text.lines();
    while let Some(head) = lines.next() {
        let name = head.strip_prefix('$').expect("a section");
        let body: Vec<&str> = lines.by_ref().take_while(|line| !line.starts_with("$End")).collect();
        writer.out.extend(format!("{head}\n").bytes());
        match name {
            "MeshFormat" => {
                writer.out.extend(body[0].replace(" 0 ", " 1 ").bytes().chain([b'\n']));
                writer.ints(&["1"]);
                writer.out.push(b'\n');
            }
            "Nodes" | "Elements" | "Entities" => {
                if is_22 {
                    writer.out.extend(format!("{}\n", body[0]).bytes());
                }
                let words: Vec<Vec<&str>> =
                    body.iter().map(|line| line.split_whitespace().collect()).collect();
                writer.section(name, is_22, &words);
                writer.out.push(b'\n');
            }
            _ => writer.out.extend(body.iter().flat_map(|line| line.bytes().chain([b'\n']))),
        }
        writer.out.extend(format!("$End{name}\n").bytes());
    }
    writer.out
}

fn read_bytes(bytes: &[u8]) -> Result<TetMesh, InputError> {
    crate::mesh::gmsh::read(Path::new("body.msh"), bytes)?.finish(LengthUnit::Metre)
}

/// Bytes in which the only occurrence of `from` is replaced.
fn replaced(bytes: &[u8], from: &[u8], to: &[u8]) -> Vec<u8> {
    let at = bytes.windows(from.len()).position(|window| window == from).expect("something to break");
    [&bytes[..at], to, &bytes[at + from.len()..]].concat()
}

/// A boundary of a volume, as Gmsh writes it.
fn with_boundary() -> String {
    V41.replacen("1 0 0 0 1 1 1 1 9 0", "1 0 0 0 1 1 1 1 9 2 1 -1", 1)
}

#[test]
fn both_byte_orders_give_the_mesh_of_the_text() {
    for text in [V22, V41, &with_boundary()] {
        let of_text = read(text).expect("sound");
        assert_eq!(of_text.tet_groups["liver"], [0, 1]);
        for little in [true, false] {
            assert_eq!(read_bytes(&binary(text, little)).expect("sound"), of_text);
        }
    }
}

#[test]
fn faults_of_a_binary_mesh_name_the_tag() {
    let fault = |text: &str, from: &str, to: &str| {
        assert!(text.contains(from), "nothing to break: {from:?}");
        read_bytes(&binary(&text.replacen(from, to, 1), true)).expect_err("planted fault").to_string()
    };
    for text in [V22, V41] {
        let error = fault(text, "20 5 40 77\n", "20 5 40 78\n");
        assert_says(&error, "body.msh", "element 200 names node 78, which is not in $Nodes", "export it");
        let error = fault(text, "20 5 40 77\n", "20 5 40 5\n");
        assert_says(&error, "body.msh", "element 200 has zero volume", "mesh the body again");
    }
    assert_says(&fault(V22, "5 0 1 0", "10 0 1 0"), "body.msh", "node 10 occurs twice", "renumber");
    assert_says(&fault(V22, "5 0 1 0", "-5 0 1 0"), "body.msh", "expected a node tag, found -5", "export it");
    assert_says(
        &fault(V41, "3 1 4 2\n", "3 1 6 2\n"),
        "body.msh",
        "element 100 is a prism",
        "tetrahedra only",
    );
    assert_says(
        &fault(V41, "2 5 5 77", "2 6 5 77"),
        "body.msh",
        "its blocks contain 5",
        "counts do not match",
    );
    let error = fault(V22, "$Nodes\n5", "$Nodes\n4");
    assert_says(&error, "body.msh", "expected $EndNodes, found", "count does not match");
    let error = fault(V22, "$Elements\n5", "$Elements\n4");
    assert_says(&error, "body.msh", "a block of 2 elements where 1 are due", "counts do not match");
}

#[test]
fn another_head_is_refused() {
    let good = binary(V41, true);
    let says = |from: &[u8], to: &[u8], what: &str, fix: &str| {
        let error = read_bytes(&replaced(&good, from, to)).expect_err("planted fault").to_string();
        assert_says(&error, "body.msh", what, fix);
    };
    says(
        b"\x01\0\0\0\n$End",
        b"\x02\0\0\0\n$End",
        "expected the mark 1 of the byte order",
        "export it again",
    );
    says(b"4.1 1 8", b"4.1 1 4", "numbers of 4 bytes are not read", "4.1 or 2.2");
    says(b"4.1 1 8", b"4.0 1 8", "Gmsh format 4 is not supported", "4.1 or 2.2");
    says(b"$EndComments", b"$EndRemarks ", "section $Comments has no $EndComments", "truncated");
}

#[test]
fn truncated_and_damaged_binary_files_are_one_clear_line() {
    for (text, little) in [(V22, true), (V22, false), (V41, true), (V41, false)] {
        let bytes = binary(text, little);
        let end = b"$EndElements";
        let needed = bytes.windows(end.len()).position(|w| w == end).expect("there") + end.len();
        for cut in 0..needed {
            let error = read_bytes(&bytes[..cut]).expect_err("a truncated file").to_string();
            assert!(error.starts_with("body.msh") && error.contains("; "), "cut at {cut}: {error}");
            assert!(!error.contains('\n'), "cut at {cut}: {error}");
        }
        for at in 0..bytes.len() {
            for byte in [0, 1, 9, b'$', b'\n', 0x7f, 0xff] {
                let mut damaged = bytes.clone();
                damaged[at] = byte;
                if let Err(error) = read_bytes(&damaged) {
                    let error = error.to_string();
                    assert!(error.starts_with("body.msh") && !error.contains('\n'), "{error}");
                }
            }
        }
    }
}
