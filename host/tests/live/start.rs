//! The start of the solver's process: progress, refusal, an early end, Ctrl-C, and the end of the session.

use super::process::{command, start, started};
use nix::unistd::{Pid, getpgid};
use palpate_core::Organ;
use palpate_host::live::{StartError, start as start_solver};
use palpate_host::sys::{pidfd, wait_readable};
use std::os::fd::AsFd;
use std::process::Stdio;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

const CERTAIN: Duration = Duration::from_secs(20);

#[test]
fn progress_comes_before_the_organ() {
    let mut lines = Vec::new();
    let ready = start_solver(command("serve"), &AtomicBool::new(false), |line| lines.push(line.to_string()))
        .expect("it starts");
    assert_eq!(lines, ["mesh", "organ"]);
    // A signal of the terminal to the session's group does not reach it.
    let solver = Pid::from_raw(ready.process.pid().expect("a process") as i32);
    assert_eq!(getpgid(Some(solver)), Ok(solver));
    let organ: Organ<'_> = Organ::read(ready.blob.bytes()).expect("a valid blob");
    assert_eq!((organ.spaces.len(), ready.view.vertices()), (3, 0));
}

#[test]
fn lines_go_both_ways_during_the_session() {
    let mut ready = started("echo");
    for word in ["stiff", "soft"] {
        assert!(ready.process.tell(word).expect("it reads"));
        let answer = ready.process.next_line(CERTAIN).expect("it goes on");
        assert_eq!(answer, Some(format!("{word} it is")));
    }
    assert_eq!(ready.process.next_line(Duration::ZERO).expect("it goes on"), None);
}

#[test]
fn a_refusal_and_an_early_end_are_reported() {
    match start("refuse") {
        Err(StartError::Refused(line)) => assert_eq!(line, "scene.toml: no equilibrium at rest"),
        other => panic!("{other:?}"),
    }
    match start("exit") {
        Err(error @ StartError::Ended(_)) => assert!(error.to_string().contains("exit status: 7"), "{error}"),
        other => panic!("{other:?}"),
    }
    let missing = std::process::Command::new("/nonexistent/palpate");
    let refused = start_solver(missing, &AtomicBool::new(false), |_| ()).expect_err("no such program");
    assert!(matches!(refused, StartError::Io(_)), "{refused}");
}

/// Ctrl-C while the solver prepares: the wait ends within 100 ms, and the process with it.
#[test]
fn the_stop_flag_ends_a_slow_start_and_its_process() {
    let stop = AtomicBool::new(false);
    let mut stopped = None;
    let refused = start_solver(command("slow"), &stop, |line| {
        if line == "step 3" {
            stop.store(true, Ordering::Relaxed);
            stopped = Some(Instant::now());
        }
    });
    let took = stopped.expect("it reports").elapsed();
    assert!(matches!(refused, Err(StartError::Stopped)) && took < Duration::from_millis(100), "{took:?}");
}

/// Starts a solver, prints its pid, and waits to be killed.
#[test]
#[ignore = "started by the next test, which kills it"]
fn session_to_kill() {
    let ready = started("serve");
    let file = std::env::var("PALPATE_PID_FILE").expect("set by the test");
    let pid = ready.process.pid().expect("a process");
    std::fs::write(format!("{file}.part"), pid.to_string()).expect("writable");
    std::fs::rename(format!("{file}.part"), file).expect("writable");
    std::thread::sleep(CERTAIN);
}

#[test]
fn the_solver_ends_with_its_session_even_while_it_is_stopped() {
    let folder = tempfile::tempdir().expect("a folder");
    for is_stopped in [false, true] {
        let file = folder.path().join(format!("pid-{is_stopped}"));
        let mut session = std::process::Command::new(std::env::current_exe().expect("a test has a file"))
            .args(["--ignored", "--exact", "live::start::session_to_kill"])
            .env("PALPATE_PID_FILE", &file)
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .expect("it starts");
        let begun = Instant::now();
        while !file.exists() {
            assert!(begun.elapsed() < CERTAIN, "no solver");
            std::thread::sleep(Duration::from_millis(5));
        }
        let pid = std::fs::read_to_string(&file).expect("readable").parse().expect("a pid");
        let solver = pidfd(pid).expect("it runs");
        assert!(!wait_readable(solver.as_fd(), Duration::from_millis(20)));
        if is_stopped {
            super::lost::signal(pid, nix::sys::signal::Signal::SIGSTOP);
        }
        session.kill().expect("it runs");
        session.wait().expect("it ends");
        assert!(
            wait_readable(solver.as_fd(), CERTAIN),
            "the solver outlives its session, stopped {is_stopped}"
        );
    }
}
