use palpate_core::{Field, JetMemory, NodeWeight};
use palpate_precompute::live::{Hand, LiveSolver, Step, Touch, Truth};
use palpate_precompute::scene::Scene;
use palpate_precompute::spec::Tolerance;
use std::path::Path;
fn main() {
    std::thread::Builder::new().stack_size(64 << 20).spawn(run).unwrap().join().unwrap();
}
fn run() {
    let deepest: f64 = std::env::args().nth(1).map_or(0.012, |x| x.parse().unwrap());
    let few: usize = std::env::args().nth(2).map_or(100000, |x| x.parse().unwrap());
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../assets/liver-small.toml");
    let scene = Scene::load(&path).and_then(|scene| scene.resolve()).expect("a bundled scene");
    let mut solver = LiveSolver::new(&scene).expect("it can be touched");
    let other = LiveSolver::new(&scene).expect("it can be touched");
    let mut truth = Truth::new(&other);
    let mut memory: Box<JetMemory<64, 256>> = Box::default();
    let triangles = solver.skin().triangles.clone();
    let mut s = 1u64;
    let mut random = || {
        s = s.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (s >> 33) as f64 / (1u64 << 31) as f64
    };
    let begun = std::time::Instant::now();
    let (mut bad, mut all, mut sum, mut worst, mut extra, mut unsolved) = (0, 0, 0.0, 0.0f64, 0, 0);
    let mut now_us = 0u64;
    for n in 1..1000000 {
        let t = triangles[((random() * triangles.len() as f64) as usize).min(few)];
        let normal = solver.skin().contacts[usize::from(t[0])].normal;
        let rest = solver.skin().contacts[usize::from(t[0])].rest_m;
        let (a, b) = (random(), random());
        let w = [a * b, a * (1.0 - b), 1.0 - a];
        let side = [0, 1, 2].map(|_| 0.02 * (random() - 0.5));
        let most = 2e-3 + deepest * random();
        let mut touch = Touch { contacts: [(0, 0.0); 3], control_m: [0.0; 3] };
        let mut felt = [0.0f32; 3];
        let mut covered = false;
        truth.release();
        for k in 0..=60 {
            let u = k as f64 / 30.0;
            let d = most * u.min(1.0);
            let x = (u - 1.0).max(0.0);
            let control_m = [0, 1, 2].map(|k| -d * normal[k] + x * side[k]);
            let contacts = [(t[0], w[0]), (t[1], w[1]), (t[2], w[2])];
            let hip_m = [0, 1, 2].map(|k| rest[k] + control_m[k]);
            touch = Touch { contacts, control_m };
            let hand = Hand {
                hip_m,
                velocity_m_s: [0, 1, 2].map(|k| if u < 1.0 { -0.03 * normal[k] } else { 3.0 * side[k] }),
                touch: Some(touch),
                ..Hand::default()
            };
            let mut steps = 0;
            loop {
                let idle = solver.step(&hand) == Step::Idle;
                while let Some(p) = solver.published() {
                    assert!(memory.insert(&p.jet(0)));
                }
                steps += 1;
                if idle || (k < 60 && steps >= 4) || steps > 100 {
                    break;
                }
            }
            for _ in 0..(if k == 60 { 400 } else { 10 }) {
                now_us += 1000;
                let f = memory
                    .force(&palpate_core::Touch {
                        now_us,
                        weights: contacts.map(|(space, weight)| NodeWeight { space, weight: weight as f32 }),
                        displacement_m: control_m.map(|x| x as f32),
                        hip_m: hip_m.map(|x| x as f32),
                        half_axis_m: None,
                    })
                    .unwrap();
                felt = f.force_n;
                covered = f.coverage != palpate_core::Coverage::Extrapolated;
            }
            if k == 30 && std::env::args().nth(3).is_some() {
                let _ = truth.force_n(&touch);
            }
        }
        match truth.force_n(&touch) {
            Ok(true_n) => {
                let e = (0..3).map(|i| (f64::from(felt[i]) - true_n[i]).powi(2)).sum::<f64>().sqrt();
                let size = true_n.iter().map(|x| x * x).sum::<f64>().sqrt();
                all += 1;
                extra += i32::from(!covered);
                if covered {
                    sum += e;
                    worst = worst.max(e);
                    bad += i32::from(e > Tolerance::IMPERCEPTIBLE.of_size(size));
                }
            }
            Err(_) => unsolved += 1,
        }
        now_us += 1000;
        memory.released(now_us);
        solver.step(&Hand::default());
        while let Some(p) = solver.published() {
            memory.insert(&p.jet(0));
        }
        if n % 100 == 0 {
            println!(
                "{:.0} s {n} all {all} extrapolated {extra} felt {bad} mean {:.1} worst {:.0} mN unsolved {unsolved} {:?}",
                begun.elapsed().as_secs_f64(),
                1e3 * sum / (all - extra) as f64,
                1e3 * worst,
                solver.totals()
            );
            (bad, all, sum, worst, extra, unsolved) = (0, 0, 0.0, 0.0, 0, 0);
        }
        if begun.elapsed().as_secs_f64() > 400.0 {
            break;
        }
    }
}
