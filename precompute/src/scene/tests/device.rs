//! `[device]`: a force limit, or a profile that has one.

use super::*;

#[test]
fn a_device_profile_gives_the_force_limit() {
    let bench = Bench::new();
    bench.write("bench.toml", "name = \"bench\"\n[limits]\nmax_force_n = 2.5\nrate_hz = 500\n");
    let device = |lines: &str| bench.with("max_force_n = 8", lines);
    for (lines, force_n) in [
        ("profile = \"falcon\"", 8.0),
        ("profile = \"touch\"", 3.3),
        ("profile = \"sigma.7\"", 12.0),
        ("profile = \"bench.toml\"", 2.5),
        // The scene's own limit applies if it is below the limit of the device.
        ("profile = \"falcon\"\nmax_force_n = 6", 6.0),
        ("profile = \"falcon\"\nmax_force_n = 8", 8.0),
    ] {
        assert_eq!(device(lines).expect("sound").max_force_n, force_n, "{lines}");
    }
    let refuses = |to: &str, place: &str, what: &str, fix: &str| {
        bench.refuses("max_force_n = 8", to, place, what, fix);
    };
    refuses(
        "profile = \"falcom\"",
        "block.toml:23",
        "no device profile \"falcom\"",
        "did you mean \"falcon\"?",
    );
    refuses("profile = \"spoon\"", "block.toml:23", "no device profile \"spoon\"", "touch");
    refuses("profile = \"none.toml\"", "none.toml", "cannot read the file", "relative to the scene file");
    refuses(
        "profile = 3",
        "block.toml:23",
        "a text in quotes is expected here, not the number 3",
        "correct the value",
    );
    let beyond = "profile = \"touch\"\nmax_force_n = 8";
    refuses(beyond, "block.toml:24", "`max_force_n` = 8 is beyond the 3.3 N of \"touch\"", "3.3 or less");
    for (text, place, what) in [
        ("[limits]\nrate_hz = 1\n", "bench.toml:1", "`max_force_n` is missing"),
        ("[limits]\n\nmax_force_n = -1\n", "bench.toml:3", "`max_force_n` = -1"),
        ("[limits\n", "bench.toml:1", "not valid TOML"),
    ] {
        bench.write("bench.toml", text);
        refuses("profile = \"bench.toml\"", place, what, "");
    }
}
