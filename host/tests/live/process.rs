//! The fake solver as a process: this test program, started again with its standard input as the socket.

use super::hammer;
use crate::fake_solver::FakeSolver;
use crate::synthetic::{self, Shape};
use palpate_core::Organ;
use palpate_host::live::{Service, StartError};
use std::process::Command;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

/// Names what the process does.
const ROLE: &str = "PALPATE_FAKE_SOLVER";

/// The command of a fake solver with this role.
pub(super) fn command(role: &str) -> Command {
    let mut command = Command::new(std::env::current_exe().expect("a test has a file"));
    command.args(["--ignored", "--exact", "live::process::fake_solver"]).env(ROLE, role);
    command.stderr(std::process::Stdio::null());
    command
}

/// Starts a fake solver and waits for it.
pub(super) fn started(role: &str) -> palpate_host::live::Ready {
    start(role).expect("it starts")
}

pub(super) fn start(role: &str) -> Result<palpate_host::live::Ready, StartError> {
    palpate_host::live::start(command(role), &AtomicBool::new(false), |_| ())
}

/// Run by the other tests in a process of its own.
#[test]
#[ignore = "started by other tests, with a socket as its standard input"]
fn fake_solver() {
    let Ok(role) = std::env::var(ROLE) else { return };
    let service = Service::of_stdin().expect("a session has started it");
    let blob = synthetic::organ(&Shape::default());
    let contacts = Organ::<'_, 256>::read(&blob).expect("valid").spaces.len() as u16;
    match role.as_str() {
        "slow" => {
            for step in 0_u64.. {
                service.report(&format!("step {step}")).expect("the session goes on");
                std::thread::sleep(Duration::from_millis(30));
            }
        }
        "refuse" => service.refuse("scene.toml: no equilibrium at rest").expect("the session goes on"),
        "exit" => std::process::exit(7),
        "hammer" => hammer::solver(service.ready(&blob, hammer::VERTICES).expect("memory")),
        "serve" => {
            service.report("mesh").expect("the session goes on");
            service.report("organ").expect("the session goes on");
            let serving = service.ready(&blob, 0).expect("memory");
            let told = serving.wait_line(Duration::ZERO);
            assert_eq!(told, None);
            let mut solver = FakeSolver::new(serving.end, contacts);
            solver.run(palpate_host::sys::monotonic_ns);
        }
        "echo" => {
            let serving = service.ready(&blob, 0).expect("memory");
            while let Some(line) = serving.wait_line(Duration::from_secs(20)) {
                assert!(serving.report(&format!("{line} it is")).expect("the session goes on"));
            }
        }
        role => panic!("unknown role {role}"),
    }
}
