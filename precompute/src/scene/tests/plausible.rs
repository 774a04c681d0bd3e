//! Warnings about units and unequal places. The diagonal of the cube is 52 in the unit of its file.

use super::*;

/// The warnings of the scene in the unit of the file, so that points and boxes do not matter.
fn warnings(unit: &str) -> Vec<String> {
    let bench = Bench::new();
    let text = SCENE.replacen("unit = \"cm\"", unit, 1);
    bench.resolve(&text.replacen("nearest = [0.31, 0.1, 0.1]", "node = 53", 1)).expect("sound").warnings
}

#[test]
fn a_body_of_unlikely_size_names_the_likely_unit() {
    let says = |unit: &str, all: &[&str]| assert_eq!(warnings(unit), all, "{unit}");
    says("", &["the body is 52 m across: is the mesh in cm? add `unit = \"cm\"` to [mesh]"]);
    says(
        "unit = \"m\"",
        &["the body is 52 m across with `unit = \"m\"`: is the mesh in cm? correct `unit` in [mesh]"],
    );
    says("unit = \"cm\"", &[]);
    says("unit = \"mm\"", &[]);
    // Without [grid], which does not suit all these sizes.
    let of_side = |side: f64, unit: &str| {
        let bench = Bench::new();
        bench.write("cube.msh", &gmsh(&cube(3, side)));
        let text = SCENE[..SCENE.find("[grid]").expect("there")].replacen("unit = \"cm\"", unit, 1);
        let text = text.replacen("group = \"left\"", "nodes = [0, 1, 4]", 1);
        bench.resolve(&text.replacen("nearest = [0.31, 0.1, 0.1]", "node = 53", 1)).expect("sound").warnings
    };
    assert_eq!(
        of_side(81.0, ""),
        ["the body is 140 m across: is the mesh in mm? add `unit = \"mm\"` to [mesh]"]
    );
    let small = of_side(0.081, "unit = \"mm\"");
    assert_eq!(
        small,
        ["the body is 0.14 mm across with `unit = \"mm\"`: is the mesh in m? correct `unit` in [mesh]"]
    );
    assert_eq!(of_side(8.1e-5, ""), ["the body is 0.14 mm across: check the scale of the mesh"]);
    assert_eq!(of_side(1.15, ""), [""; 0], "1.99 m");
    assert_eq!(of_side(0.0029, ""), [""; 0], "5.02 mm");
}

#[test]
fn an_unlikely_modulus_is_told() {
    let bench = Bench::new();
    let law = "law = \"mooney-rivlin\"\nc10_pa = 1300.0\nc01_pa = 1280.0";
    let with = |mu: &str| {
        let law_of = format!("law = \"neo-hookean\"\nlambda_pa = 1e4\nmu_pa = {mu}");
        bench.with(law, &law_of).expect("sound").warnings
    };
    let [soft] = &with("9.9")[..] else { panic!("one warning") };
    assert!(soft.contains("\"neo-hookean\") has a shear modulus of 9.9 Pa at rest: is it in kPa"), "{soft}");
    let [stiff] = &with("1.1e9")[..] else { panic!("one warning") };
    assert!(stiff.contains("1100000000 Pa at rest: is a power of ten wrong?"), "{stiff}");
    assert_eq!([with("10.0"), with("1e9")].concat(), [""; 0]);
}

#[test]
fn places_on_unequal_meshes_are_told_once() {
    let bench = Bench::new();
    let mut mesh = cube(3, 30.0);
    // The far part of the body along y is stretched.
    for x in &mut mesh.nodes_m {
        x[1] *= if x[1] > 15.0 { 4.0 } else { 1.0 };
    }
    bench.write("cube.msh", &gmsh(&mesh));
    let of = |first: &str, second: &str| {
        let text = SCENE.replacen("node = 63", first, 1).replacen("nearest = [0.31, 0.1, 0.1]", second, 1);
        bench.resolve(&text).expect("sound").warnings
    };
    let [told] = &of("node = 63", "node = 48")[..] else { panic!("one warning") };
    assert!(told.starts_with("the forces at \"A2\" and \"A1\" cannot be compared"), "{told}");
    assert!(
        told.contains("(edges of 114 mm and ") && told.ends_with("the finer place feels softer"),
        "{told}"
    );
    assert_eq!(of("node = 48", "node = 51"), [""; 0], "equal elements");
    assert_eq!(of("node = 48", "group = \"right\"").join("\n").matches("compared").count(), 0, "a group");
}
