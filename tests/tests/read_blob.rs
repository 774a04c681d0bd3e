//! The Python reader (tests/peers/read_blob.py) compared with the core, on a blob written as `palpate pack`
//! does.
//!
//! The tests need numpy for /usr/bin/python3, which a bare machine lacks. They are ignored by default;
//! `tests/peers/numpy` installs numpy and runs them.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use palpate_core::{Coverage, Method, Organ, Space};
use palpate_host::BlobFile;
use palpate_precompute::certificate::certify;
use palpate_precompute::pack::{PackOptions, pack};
use palpate_precompute::spec::{DisplacementBound, Sampling, Scattered, Tolerance};
use palpate_tests::space_bench::SpaceBench;

const PYTHON: &str = "/usr/bin/python3";

fn reader(arguments: &[&Path]) -> Output {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("peers/read_blob.py");
    Command::new(PYTHON).arg("-B").arg(script).args(arguments).output().expect("Python starts")
}

/// A blob of the soft beam with all its parts, and its folder. A tight error bound makes the packer store
/// slopes.
fn blob(folder: &Path) -> (PathBuf, BlobFile) {
    let mut bench = SpaceBench::new(f64::INFINITY);
    bench.identity.displacement_bound = DisplacementBound { rms_m: 2e-5, max_m: 2e-4 };
    let (store, _) = bench.solve(&folder.join("a.space"), 2);
    let options = PackOptions { methods: &Method::OF_LATTICE, use_intermediate_states: false, threads: 1 };
    let mut packed = pack(&store, &options).expect("the space packs");
    let plain = BlobFile::of(&packed.bytes().expect("bytes"));
    let organ: Box<Organ<'_>> = Organ::read_boxed(plain.bytes()).expect("readable");
    let certificate = certify(&store, &organ).expect("certified");
    let json = serde_json::to_string(&certificate).expect("JSON");
    packed.certify(&json).expect("room");
    let bytes = packed.bytes().expect("bytes");
    packed.certify(&json).expect("room");
    assert_eq!(packed.bytes().expect("bytes"), bytes, "a certificate replaces the one before");
    let path = folder.join("a.blob");
    std::fs::write(&path, &bytes).expect("written");
    (path, BlobFile::of(&bytes))
}

/// Positions inside, on points and faces, on the rim and beyond, and a NaN.
fn points(space: &Space<'_>) -> Vec<[f32; 3]> {
    let r = space.lattice().radius_m();
    let mut points = vec![[0.0; 3], [f32::NAN, 0.0, 0.0], [1e30, 0.0, -1e30]];
    for n in 0..400_u32 {
        let turn = f64::from(n + 1);
        let d = [1.3, 2.9, 4.7].map(|by| 1.3 * r * f64::sin(turn * by) as f32);
        let on_grid = |x: f32| (x / space.lattice().spacing_m()).round() * space.lattice().spacing_m();
        points.push(match n % 5 {
            0 => d.map(on_grid),
            1 => [d[0], on_grid(d[1]), d[2]],
            _ => d,
        });
    }
    points.extend(space.lattice().points().map(|ijk| space.lattice().displacement_m(ijk)));
    points
}

#[test]
#[ignore = "needs numpy: tests/peers/numpy runs it"]
fn a_reader_written_from_the_documentation_gives_the_cores_forces() {
    let folder = tempfile::tempdir().expect("a folder");
    let (path, file) = blob(folder.path());
    let organ: Box<Organ<'_>> = Organ::read_boxed(file.bytes()).expect("readable");
    let space = &organ.spaces[0];
    let table = space.displacement().expect("the space has displacements");
    assert!(table.planes().slopes > 0, "the blob must contain slopes");

    let shown = reader(&[&path]);
    let text = String::from_utf8(shown.stdout).expect("text");
    assert!(shown.status.success(), "{}", String::from_utf8_lossy(&shown.stderr));
    let expected = [
        format!("scene beam, law mooney-rivlin, f_max inf N, {} bytes", file.bytes().len()),
        "trilinear, tricubic, hybrid, rbf-linear, rbf-cubic, hermite, energy".into(),
        format!(
            "displacements: {} modes, {} with slopes, {} outliers",
            table.planes().scale.len(),
            table.planes().slopes,
            table.planes().outlier_row.len()
        ),
        "certificate of 1 spaces".into(),
    ];
    for line in expected {
        assert!(text.contains(&line), "{line} is not in\n{text}");
    }

    let points = points(space);
    let (input, output) = (folder.path().join("in.csv"), folder.path().join("out.csv"));
    let rows: String = points.iter().map(|[x, y, z]| format!("{x:?},{y:?},{z:?}\n")).collect();
    std::fs::write(&input, format!("x_m,y_m,z_m\n{rows}")).expect("written");
    let (mut largest, mut moved) = (0.0f64, vec![[0.0f32; 3]; organ.surface.node.len()]);
    for method in [Method::Trilinear, Method::Hermite, Method::Energy] {
        let arguments = ["--points".as_ref(), input.as_path(), "--csv".as_ref(), output.as_path()];
        let last = ["--method".as_ref(), Path::new(method.name()), "--displacements".as_ref()];
        let done = reader(&[&[path.as_path()][..], &arguments, &last].concat());
        assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
        let table = std::fs::read_to_string(&output).expect("written");
        assert_eq!(table.lines().count(), points.len() + 1);
        for (line, &at) in table.lines().skip(1).zip(&points) {
            let cells: Vec<&str> = line.split(',').collect();
            let number = |column: usize| cells[column].parse::<f64>().expect("a number");
            let exact = space.force(method, at).expect("packed");
            for axis in 0..3 {
                let (found, core) = (number(3 + axis), f64::from(exact.force_n[axis]));
                assert!((found - core).abs() < 1e-5, "{} at {at:?}: {found} N, core {core} N", method.name());
                largest = largest.max(core.abs());
            }
            assert_eq!(cells[6] == "cell", exact.coverage == Coverage::Cell, "{at:?}");
            assert!(space.displacement_into(at, &mut moved));
            for (column, core) in (7..).zip(moved.as_flattened()) {
                let found = number(column);
                assert!(
                    (found - f64::from(*core)).abs() < 1e-7,
                    "{at:?}, column {column}: {found} m, core {core} m"
                );
            }
        }
    }
    assert!(largest > 0.1, "the forces must be large enough to compare: {largest} N");
}

#[test]
#[ignore = "needs numpy: tests/peers/numpy runs it"]
fn the_reader_refuses_a_damaged_file() {
    let folder = tempfile::tempdir().expect("a folder");
    let (path, file) = blob(folder.path());
    let mut bytes = file.bytes().to_vec();
    bytes[5000] ^= 1;
    std::fs::write(&path, &bytes).expect("written");
    for (len, says) in [(bytes.len(), "checksum mismatch"), (bytes.len() - 1, "bytes"), (3, "not a blob")] {
        std::fs::write(&path, &bytes[..len]).expect("written");
        let refused = reader(&[&path]);
        let line = String::from_utf8(refused.stderr).expect("text");
        assert_eq!(refused.status.code(), Some(2), "{line}");
        assert!(
            line.starts_with("read_blob: ") && line.contains(says) && line.lines().count() == 1,
            "{line}"
        );
    }
}

/// A fit of scattered positions.
#[test]
#[ignore = "needs numpy: tests/peers/numpy runs it"]
fn the_reader_gives_the_cores_forces_of_a_kernel() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut bench = SpaceBench::new(1.0);
    let tolerance = Tolerance { relative: 0.035, absolute_n: 0.005 };
    bench.identity.sampling =
        Sampling::Scattered(Scattered { radius_m: 0.01, tolerance, only_push: false, workspace_m: None });
    let (store, _) = bench.solve(&folder.path().join("a.space"), 2);
    let options = PackOptions {
        methods: &[Method::Energy, Method::Kernel],
        use_intermediate_states: false,
        threads: 1,
    };
    let bytes = pack(&store, &options).expect("it packs").bytes().expect("bytes");
    let file = BlobFile::of(&bytes);
    let organ: Box<Organ<'_>> = Organ::read_boxed(file.bytes()).expect("readable");
    let space = &organ.spaces[0];
    let [path, input, output] = ["a.blob", "in.csv", "out.csv"].map(|name| folder.path().join(name));
    std::fs::write(&path, &bytes).expect("written");
    let r = space.lattice().radius_m();
    let points: Vec<[f32; 3]> = (1..200)
        .map(|n| [1.3, 2.9, 4.7].map(|by| 1.2 * r * f64::sin(f64::from(n) * by) as f32))
        .chain([[0.0; 3], [1e30, 0.0, -1e30]])
        .collect();
    let rows: String = points.iter().map(|[x, y, z]| format!("{x:?},{y:?},{z:?}\n")).collect();
    std::fs::write(&input, format!("x_m,y_m,z_m\n{rows}")).expect("written");
    let [method, kernel, from, to] = ["--method", "kernel", "--points", "--csv"].map(Path::new);
    let done = reader(&[&path, method, kernel, from, &input, to, &output]);
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    let table = std::fs::read_to_string(&output).expect("written");
    assert_eq!(table.lines().count(), points.len() + 1);
    for (line, &at) in table.lines().skip(1).zip(&points) {
        let cells: Vec<&str> = line.split(',').collect();
        let exact = space.force(Method::Kernel, at).expect("packed");
        for axis in 0..3 {
            let found: f64 = cells[3 + axis].parse().expect("a number");
            assert!((found - f64::from(exact.force_n[axis])).abs() < 2e-5, "{at:?}: {line} {exact:?}");
        }
        assert_eq!(cells[6] == "cell", exact.coverage == Coverage::Scattered, "{at:?}");
    }
}
