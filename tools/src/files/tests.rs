use std::os::unix::fs::symlink;

use super::*;

const FORCE: Replace = Replace { force: true };

/// A folder with files of several kinds.
struct TestFolder(tempfile::TempDir);

impl TestFolder {
    fn new() -> Self {
        let shelf = Self(tempfile::tempdir().expect("a folder"));
        shelf.put("scene.toml", b"[mesh]\nfile = \"a.msh\"\n");
        shelf.put("table.csv", b"x_m,y_m\n0,0\n");
        shelf.put("picture.png", b"\x89PNG\r\n\x1a\n\0");
        shelf.put("empty", b"");
        shelf
    }

    fn at(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn put(&self, name: &str, bytes: &[u8]) {
        std::fs::write(self.at(name), bytes).expect("writable");
    }

    fn names(&self) -> Vec<String> {
        let entries = std::fs::read_dir(self.0.path()).expect("readable");
        let names = entries.map(|entry| entry.expect("an entry").file_name().into_string().expect("text"));
        let mut names: Vec<String> = names.collect();
        names.sort_unstable();
        names
    }
}

fn line(refused: Result<Output, Failure>) -> String {
    refused.expect_err("refused").line()
}

#[test]
fn an_output_is_no_input_by_whatever_name() {
    let shelf = TestFolder::new();
    let scene = shelf.at("scene.toml");
    symlink(&scene, shelf.at("link.csv")).expect("a link");
    symlink("link.csv", shelf.at("link-of-link.csv")).expect("a link");
    std::fs::hard_link(&scene, shelf.at("hard.csv")).expect("a link");
    std::fs::create_dir(shelf.at("sub")).expect("a folder");
    for name in ["scene.toml", "sub/../scene.toml", "link.csv", "link-of-link.csv", "hard.csv"] {
        for replace in [Replace::default(), FORCE] {
            let mut files = Files::new(replace);
            files.read(&scene);
            let line = line(files.write("--csv", &shelf.at(name), FileKind::Table));
            assert!(
                line.contains(&format!("{name}: is the input ")) && line.contains("scene.toml"),
                "{line}"
            );
        }
    }
}

#[test]
fn two_outputs_are_two_files_even_before_they_are_there() {
    let shelf = TestFolder::new();
    symlink("new.csv", shelf.at("link.csv")).expect("a link to what is not there");
    for name in ["new.csv", "link.csv"] {
        let mut files = Files::new(FORCE);
        files.write("--csv", &shelf.at("new.csv"), FileKind::Table).expect("a new file");
        let line = line(files.write("--held-out", &shelf.at(name), FileKind::Table));
        assert!(line.contains("--held-out") && line.contains("is the output --csv"), "{line}");
    }
    // A write through a dangling link creates the target of the link.
    let output =
        Files::new(FORCE).write("--csv", &shelf.at("link.csv"), FileKind::Table).expect("a new file");
    output.put(b"x_m,y_m\n").expect("written");
    assert!(shelf.at("link.csv").is_symlink() && shelf.at("new.csv").is_file());
    // Writing to a device replaces no file.
    let mut files = Files::new(Replace::default());
    for option in ["--csv", "--held-out"] {
        let output = files.write(option, Path::new("/dev/null"), FileKind::Table).expect("a device");
        output.put(b"x").expect("written");
    }
}

#[test]
fn only_a_file_of_the_same_kind_is_replaced_unless_forced() {
    let shelf = TestFolder::new();
    let write = |replace, name: &str, kind| Files::new(replace).write("--out", &shelf.at(name), kind);
    for (name, kind) in
        [("table.csv", FileKind::Table), ("picture.png", FileKind::Png), ("empty", FileKind::Blob)]
    {
        write(Replace::default(), name, kind).expect("of the same kind, or empty");
    }
    for (name, kind) in
        [("scene.toml", FileKind::Table), ("table.csv", FileKind::Blob), ("picture.png", FileKind::Gif)]
    {
        let line = line(write(Replace::default(), name, kind));
        assert!(line.contains(name) && line.contains("--force"), "{line}");
        write(FORCE, name, kind).expect("forced");
    }
    // A space replaces no file, and a recording not even another recording.
    assert!(!line(write(FORCE, "table.csv", FileKind::Space)).contains("--force"));
    let line = line(Files::new(FORCE).write_new("--record", &shelf.at("table.csv")));
    assert!(line.contains("table.csv: already exists"), "{line}");
    assert_eq!(
        shelf.names(),
        ["empty", "picture.png", "scene.toml", "table.csv"],
        "nothing is left of probes"
    );
}

#[test]
fn places_that_take_no_file_are_refused_before_the_work() {
    let shelf = TestFolder::new();
    let write = |path: &Path| line(Files::new(FORCE).write("--csv", path, FileKind::Table));
    assert!(write(shelf.0.path()).contains("is a folder"));
    assert!(write(&shelf.at("nowhere/a.csv")).contains("nowhere/a.csv: No such file or directory"));
    assert!(write(&shelf.at("table.csv/a.csv")).contains("Not a directory"));
    let folder = Files::new(FORCE).folder("--out", &shelf.at("table.csv"), |_| None);
    assert!(folder.expect_err("refused").line().ends_with("table.csv: is a file; give a folder"));
}

#[test]
fn a_folder_of_outputs_holds_no_input_and_nothing_else_under_their_names() {
    let shelf = TestFolder::new();
    let kind_of = |name: &str| name.ends_with(".csv").then_some(FileKind::Table);
    let open = |read: &str| {
        let mut files = Files::new(Replace::default());
        files.read(&shelf.at(read));
        files.folder("--out", shelf.0.path(), kind_of).map(|folder| folder.file("new.csv"))
    };
    open("scene.toml").expect("tables are not written over it").put(b"x_m,y_m\n").expect("written");
    assert!(line(open("table.csv")).contains("is the input"));
    std::fs::rename(shelf.at("picture.png"), shelf.at("picture.csv")).expect("renamed");
    assert!(line(open("scene.toml")).contains("picture.csv: is a picture (PNG)"));
}

#[test]
fn a_space_brings_the_files_beside_it() {
    let shelf = TestFolder::new();
    let mut files = Files::new(FORCE);
    files.update_space(&shelf.at("a.space"));
    let line = line(files.write("--out", &shelf.at("a.space-wal"), FileKind::Blob));
    assert!(line.contains("a.space-wal: is the input"), "{line}");
}

#[test]
fn a_stream_that_is_not_finished_leaves_nothing() {
    use std::io::Write;
    let shelf = TestFolder::new();
    let output = Files::new(FORCE).write("--csv", &shelf.at("new.csv"), FileKind::Table).expect("a new file");
    let before = shelf.names();
    let mut stream = output.stream().expect("begun");
    stream.write_all(b"x_m,y_m\n").expect("written");
    drop(stream);
    assert_eq!(shelf.names(), before);
    let mut stream = output.stream().expect("begun");
    stream.write_all(b"x_m,y_m\n").expect("written");
    stream.finish().expect("renamed");
    assert_eq!(std::fs::read(shelf.at("new.csv")).expect("there"), b"x_m,y_m\n");
    assert_eq!(shelf.names().len(), before.len() + 1);
}
