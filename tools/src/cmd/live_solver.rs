//! `palpate live-solver`: the process beside a `palpate live` that solves where the hand goes.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Weak};
use std::time::{Duration, Instant};

use clap::Args as ClapArgs;
use palpate_host::live::{Counters, Hand, Heart, Service, Serving, SessionEnded, Work};
use palpate_host::sys::{cpu_ns, lower_priority, monotonic_ns};
use palpate_precompute::live::{Axis, Hand as Seen, LiveSolver, Partner, Step, Touch};
use palpate_precompute::scene::{ResolvedScene, Scene};

use crate::blob;
use crate::failure::Failure;
use crate::setting::split;

/// Pause while everything near the hand is known.
const IDLE_PAUSE: Duration = Duration::from_micros(300);
/// The line for the user while the tool presses on the fixed part, again after a time.
pub(super) const FIXED_PART: &str =
    "the tool presses on the fixed part, which is felt as a wall, not as tissue";
/// The same where a touch cannot begin.
const UNFELT: &str =
    "the tool is in the body or overlaps its skin, and feels nothing; lift it off, and touch again";
const WARNING: Duration = Duration::from_secs(10);
/// Time between two pictures of the surface.
const PICTURE: Duration = Duration::from_millis(33);
/// Time between two heartbeats.
const BEAT: Duration = Duration::from_millis(20);
/// A solve that takes longer has failed in a way that nobody foresaw: the heart stops. Every loop of the solver is
/// bounded, so a large body may take many seconds, but not this long.
const LONGEST_SOLVE: Duration = Duration::from_secs(120);
/// Time before jets that the loop lacks are sent once more.
const RESEND: Duration = Duration::from_millis(200);
/// Jets that are sent between two solves.
const SENT: usize = 32;
/// Jets of a contact that are sent once more, the nearest ones: the loop keeps four times as many.
const RESENT: usize = 64;

/// Solve where the hand of `palpate live` goes.
///
/// `palpate live` starts it with a socket as its standard input. It ends with its session.
#[derive(Debug, ClapArgs)]
pub(crate) struct Args {
    /// Scene
    scene: PathBuf,
    /// Values that differ from the scene file
    #[arg(long, value_name = "KEY=VALUE")]
    set: Vec<String>,
    /// Blob of the same model, whose tables are known from the start
    #[arg(long, value_name = "FILE.blob")]
    blob: Option<PathBuf>,
}

/// Runs the command.
pub(crate) fn run(args: &Args) -> Result<(), Failure> {
    let by_hand =
        |error| Failure::input(format!("{error}: live-solver is started by `palpate live`, not by hand"));
    let service = Service::of_stdin().map_err(by_hand)?;
    let ended = |_| Failure::work("the session has ended");
    match prepare(args, &service) {
        Ok((scene, solver, blob, nodes)) => {
            let serving = service.ready(&blob, nodes.len()).map_err(ended)?;
            Solving::new(scene, solver, serving, nodes).run();
            Ok(())
        }
        Err(failure) => {
            // The session prints it.
            service.refuse(&failure.line()).map_err(ended)
        }
    }
}

/// The scene, its solver, the blob of its organ, and the nodes of the organ's surface.
fn prepare(args: &Args, service: &Service) -> Result<(Scene, LiveSolver, Vec<u8>, Vec<u32>), Failure> {
    let scene = scene(&args.scene, &args.set)?;
    let resolved = scene.resolve()?;
    let mut solver = solver(&args.scene, &resolved)?;
    if let Some(path) = &args.blob {
        let file = blob::load(path)?;
        let organ = blob::organ(path, &file)?;
        let named = |error| Failure::input(format!("{}: {error}", path.display()));
        let (contacts, jets) = solver.begin_with(&organ, &resolved).map_err(named)?;
        let all = organ.spaces.len();
        let line = format!("{}: {contacts} of {all} contacts are known, by {jets} jets", path.display());
        // The session may have ended.
        let _ = service.report(&line);
    }
    solver.renew_beside(lower_priority);
    let (blob, nodes) = solver.organ(&resolved)?;
    Ok((scene, solver, blob, nodes))
}

/// The scene of a live session, with values that differ from its file.
pub(super) fn scene(path: &Path, settings: &[String]) -> Result<Scene, Failure> {
    let mut scene = Scene::load(path)?;
    for setting in settings {
        let (key, value) = split(setting)?;
        scene = scene.with(key, value)?;
    }
    Ok(scene)
}

/// The solver of a scene.
pub(super) fn solver(path: &Path, scene: &ResolvedScene) -> Result<LiveSolver, Failure> {
    LiveSolver::new(scene).map_err(|error| Failure::input(format!("{}: {error}", path.display())))
}

/// What the solver sees of a hand.
fn seen(hand: &Hand) -> Seen {
    let touch = hand.is_engaged.then(|| Touch {
        contacts: hand.engaged.map(|node| (node.space, f64::from(node.weight))),
        control_m: hand.displacement_m.map(f64::from),
    });
    Seen {
        hip_m: hand.hip_m.map(f64::from),
        velocity_m_s: hand.velocity_m_s.map(f64::from),
        touch,
        partner: hand.partner.map(|partner| Partner {
            position_m: partner.position_m.map(f64::from),
            velocity_m_s: partner.velocity_m_s.map(f64::from),
        }),
        axis: hand.axis.map(|axis| Axis {
            half_m: axis.half_m.map(f64::from),
            velocity_m_s: axis.velocity_m_s.map(f64::from),
        }),
    }
}

/// A session from the solver's side.
struct Solving {
    scene: Scene,
    solver: LiveSolver,
    serving: Serving,
    nodes: Vec<u32>,
    displacements_m: Vec<[f32; 3]>,
    shown: Instant,
    /// Whether the last picture shows the body at rest.
    at_rest: bool,
    sequence: u32,
    resent: Option<(u16, Instant)>,
    counters: Counters,
    /// CPU time of the process when the session began, ns.
    begun_ns: u64,
    /// When the user was last told that the tool presses on the fixed part.
    warned: Option<(&'static str, Instant)>,
    /// A change of the scene whose touch is not known yet, and when it began.
    changing: Option<(String, Instant)>,
    /// When the present solve began, CLOCK_MONOTONIC, ns; 0 between two.
    solving_ns: Arc<AtomicU64>,
}

impl Solving {
    fn new(scene: Scene, solver: LiveSolver, serving: Serving, nodes: Vec<u32>) -> Self {
        let solving_ns = Arc::new(AtomicU64::new(0));
        let (heart, watched) = (serving.end.heart(), Arc::downgrade(&solving_ns));
        std::thread::spawn(move || beat(&heart, &watched));
        Self {
            scene,
            solver,
            serving,
            displacements_m: vec![[0.0; 3]; nodes.len()],
            nodes,
            shown: Instant::now(),
            at_rest: true,
            sequence: 0,
            resent: None,
            counters: Counters::default(),
            begun_ns: cpu_ns(),
            warned: None,
            changing: None,
            solving_ns,
        }
    }

    /// Until the session ends.
    fn run(mut self) {
        while !self.serving.end.has_session_ended() {
            let hand = self.serving.end.hand();
            let seen = seen(&hand);
            if self.solver.is_ready() {
                self.report_change();
            }
            if let Some(setting) = self.serving.next_line() {
                self.change(setting);
            }
            if hand.t_us > 0 {
                self.show(&seen);
            }
            if self.send().is_err() || self.resend(&hand, |missing| missing).is_err() {
                return;
            }
            self.solving_ns.store(monotonic_ns(), Ordering::Relaxed);
            self.serving.end.set_work(Work::Solving);
            let begun = Instant::now();
            // Before the first tick nobody knows where the hand is.
            let step = if hand.t_us > 0 { self.solver.step(&seen) } else { Step::Idle };
            let took = begun.elapsed();
            self.solving_ns.store(0, Ordering::Relaxed);
            self.counters.busy_ns = cpu_ns() - self.begun_ns;
            if step == Step::Idle {
                self.serving.end.set_work(Work::Idle);
                self.serving.end.set_counters(self.counters);
                // What is known here and not there was given up for other jets.
                let lacks = hand.is_engaged && hand.is_extrapolated;
                if lacks && self.resend(&hand, |_| true).is_err() {
                    return;
                }
                std::thread::sleep(IDLE_PAUSE);
                continue;
            }
            self.solver.took(took.as_secs_f64());
            match step {
                Step::Solved => self.counters.solves += 1,
                Step::Lost { .. } => self.counters.lost += 1,
                Step::Renewing | Step::Followed | Step::Idle => {}
            }
            if self.send().is_err() {
                return;
            }
            self.serving.end.set_counters(self.counters);
        }
    }

    /// Changes a value of the scene. What came of it is reported once the touch is known.
    fn change(&mut self, setting: String) {
        let begun = Instant::now();
        self.report_change();
        self.solving_ns.store(monotonic_ns(), Ordering::Relaxed);
        let changed = self.changed(&setting);
        self.solving_ns.store(0, Ordering::Relaxed);
        match changed {
            Ok(()) => self.changing = Some((setting, begun)),
            // The session may have ended.
            Err(failure) => drop(self.serving.report(&failure.line())),
        }
        self.at_rest = false;
    }

    /// Reports the last change.
    fn report_change(&mut self) {
        if let Some((setting, begun)) = self.changing.take() {
            // The session may have ended.
            let _ = self.serving.report(&format!("{setting} ({:.2} s)", begun.elapsed().as_secs_f64()));
        }
    }

    fn changed(&mut self, setting: &str) -> Result<(), Failure> {
        let (key, value) = split(setting)?;
        let scene = self.scene.with(key, value)?;
        self.solver.change(&scene.resolve()?).map_err(Failure::input)?;
        self.scene = scene;
        Ok(())
    }

    /// Sends jets that are ready; not all at once, because the loop takes one a tick.
    fn send(&mut self) -> Result<(), SessionEnded> {
        for published in std::iter::from_fn(|| self.solver.published()).take(SENT) {
            self.sequence += 1;
            self.serving.end.send(&published.jet(self.sequence))?;
        }
        Ok(())
    }

    /// Sends jets of a touched contact again that the loop has given up for others; `lacks` says by whether it has
    /// none whether that is so.
    fn resend(&mut self, hand: &Hand, lacks: impl Fn(bool) -> bool) -> Result<(), SessionEnded> {
        let touched = hand.engaged.iter().zip(hand.missing).filter(|(node, _)| node.weight > 0.0);
        let lacking = touched.filter(|(_, missing)| lacks(*missing));
        let Some((node, _)) = lacking.max_by(|(a, _), (b, _)| a.weight.total_cmp(&b.weight)) else {
            return Ok(());
        };
        let contact = node.space;
        let is_recent = |&(of, at): &(u16, Instant)| of == contact && at.elapsed() < RESEND;
        if self.resent.as_ref().is_some_and(is_recent) {
            return Ok(());
        }
        let at_m = hand.displacement_m.map(f64::from);
        let mut jets: Vec<_> = self.solver.jets(contact).collect();
        jets.sort_by(|a, b| a.distance_m(at_m).total_cmp(&b.distance_m(at_m)));
        jets.truncate(RESENT);
        for published in &jets {
            self.sequence += 1;
            self.serving.end.send(&published.jet(self.sequence))?;
        }
        if !jets.is_empty() {
            self.resent = Some((contact, Instant::now()));
        }
        Ok(())
    }

    /// Shows the surface, if a picture is due.
    fn show(&mut self, hand: &Seen) {
        let at_rest = hand.touch.is_none();
        if self.shown.elapsed() < PICTURE {
            return;
        }
        self.warn(hand);
        if !at_rest || !self.at_rest {
            self.solver.displacements_into(hand, &self.nodes, &mut self.displacements_m);
            self.serving.end.show(&self.displacements_m);
        }
        (self.shown, self.at_rest) = (Instant::now(), at_rest);
    }

    /// Tells the user if the tool is where it feels no tissue.
    fn warn(&mut self, hand: &Seen) {
        let line = if self.solver.overlaps_unfelt(hand) {
            UNFELT
        } else if self.solver.presses_fixed_part(hand) {
            FIXED_PART
        } else {
            return;
        };
        if self.warned.is_none_or(|(before, at)| before != line || at.elapsed() > WARNING) {
            // The session may have ended.
            let _ = self.serving.report(line);
            self.warned = Some((line, Instant::now()));
        }
    }
}

/// Beats while the session lasts and no solve takes too long.
fn beat(heart: &Heart, solving_ns: &Weak<AtomicU64>) {
    while let Some(solving_ns) = solving_ns.upgrade() {
        let (now_ns, begun_ns) = (monotonic_ns(), solving_ns.load(Ordering::Relaxed));
        if begun_ns == 0 || now_ns.saturating_sub(begun_ns) < LONGEST_SOLVE.as_nanos() as u64 {
            heart.beat(now_ns);
        }
        std::thread::sleep(BEAT);
    }
}
