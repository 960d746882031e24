//! Small trainings from photographs of an analytic object.

use megas_capture::{Capture, Photo, extent, seeds};
use megas_math::vec3;
use megas_metrics::assets::{Shape, Solid, camera_rig, photograph};
use megas_model::Splats;
use megas_reconstruct::{
    Background, ExposureRates, FinetuneOptions, Mcmc, Method, Options, Profile, PruneEvent, Region, Teacher, Trainer, initial_splats,
};

const TORUS: Shape = Shape::Torus { major: 0.7, minor: 0.3 };

/// Views of a torus: the first eight to train on.
fn capture(side: u32) -> Capture {
    let solid = TORUS;
    let mut photos: Vec<Photo> = camera_rig(solid.bounds(), 10, 4, side, side)
        .iter()
        .enumerate()
        .map(|(k, camera)| {
            let view = photograph(&solid, camera, 2, &format!("{k}"));
            Photo { name: view.name, camera: view.camera, channels: 4, pixels: view.image.to_u8(), mask: None }
        })
        .collect();
    let test = photos.split_off(10);
    Capture { train: photos, test, points: None, kind: "generated", notes: Vec::new() }
}

/// Options with every milestone within `iterations`.
fn options(capture: &Capture, method: Method, iterations: u32) -> Options {
    let e = extent(capture.train.iter().map(|p| &p.camera));
    let (lo, hi) = TORUS.bounds();
    let mut o = Options::with_iterations(method, Profile::Tiny, iterations, e, Some(Region::aligned(lo, hi)), true, None);
    if let Some(r) = &mut o.refinement {
        (r.start, r.every, r.stop, r.reset_every, r.trim_every, r.trim_start) = (10, 10, iterations / 2, 30, 20, 20);
    }
    if !o.prune.is_empty() {
        o.prune = vec![PruneEvent { step: iterations * 3 / 5, tau: 0.05 }];
    }
    o.weights.normal_start = o.weights.normal_start.min(iterations / 3);
    o.sh_every = iterations / 5;
    o
}

fn trainer(side: u32, method: Method, iterations: u32) -> Trainer {
    let capture = capture(side);
    let options = options(&capture, method, iterations);
    let start = initial_splats(&seeds(&capture, 600, 3));
    Trainer::new(capture.train, start, options)
}

fn test_psnr(trainer: &mut Trainer, capture: &Capture) -> f64 {
    let mut sum = 0.0;
    for p in &capture.test {
        let image = trainer.render(&p.camera, [1.0; 3]);
        let error: f64 = image
            .data
            .chunks_exact(3)
            .zip(p.pixels.chunks_exact(4))
            .map(|(a, b)| {
                let alpha = f32::from(b[3]) / 255.0;
                (0..3).map(|k| (a[k].clamp(0.0, 1.0) - f32::from(b[k]) / 255.0 * alpha - 1.0 + alpha).powi(2)).sum::<f32>()
            })
            .map(f64::from)
            .sum();
        sum += -10.0 * (error / image.data.len() as f64).log10();
    }
    sum / capture.test.len() as f64
}

fn same(a: &Splats, b: &Splats) {
    assert_eq!(a.len(), b.len());
    assert!(a.mean == b.mean && a.log_scale == b.log_scale && a.rotation == b.rotation, "shapes differ");
    assert!(a.opacity_logit == b.opacity_logit && a.sh == b.sh, "appearances differ");
}

#[test]
fn a_short_training_explains_views_it_has_not_seen() {
    let capture = capture(64);
    let mut t = trainer(64, Method::Ours, 300);
    let before = test_psnr(&mut t, &capture);
    while !t.done() {
        let report = t.step();
        assert!(report.loss.is_finite() && report.gaussians > 0, "{report:?}");
    }
    let after = test_psnr(&mut t, &capture);
    assert!(after > before + 8.0 && after > 25.0, "{before} {after}");
    // What our method promises: no needles, no kernel above the clamp, nothing that no view shows.
    let limit = t.options().scale_limit.unwrap();
    for l in &t.splats().log_scale {
        let mut s = l.map(f32::exp);
        s.sort_by(f32::total_cmp);
        assert!(s[2] <= limit * 1.001, "{s:?} above {limit}");
    }
    let needles = t.splats().log_scale.iter().filter(|l| {
        let mut s = **l;
        s.sort_by(f32::total_cmp);
        s[2] - s[1] > 2.4f32.ln()
    });
    assert!(needles.count() * 50 < t.splats().len());
}

#[test]
fn trainings_do_not_depend_on_threads() {
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let mut t = trainer(48, Method::Ours, 60);
            while !t.done() {
                t.step();
            }
            t.export()
        })
    };
    same(&run(1), &run(3));
}

#[test]
fn a_resumed_training_is_the_uninterrupted_one() {
    for method in [Method::Ours, Method::Vanilla] {
        let mut whole = trainer(48, method, 60);
        let mut saved = Vec::new();
        while !whole.done() {
            if whole.step_count() == 33 {
                whole.save(&mut saved).unwrap();
            }
            whole.step();
        }
        let mut resumed = trainer(48, method, 60);
        resumed.step();
        resumed.load(&mut &saved[..], saved.len() as u64).unwrap();
        assert_eq!(resumed.step_count(), 33);
        while !resumed.done() {
            resumed.step();
        }
        same(whole.splats(), resumed.splats());
    }
}

/// Opaque views over grey, of which every other one was exposed half as long.
fn unevenly_exposed(side: u32) -> Capture {
    let mut c = capture(side);
    for (k, p) in c.train.iter_mut().enumerate() {
        let gain = if k % 2 == 0 { 1.0 } else { 0.5 };
        let over = |px: &[u8]| {
            let alpha = f32::from(px[3]) / 255.0;
            [0, 1, 2].map(|k| (gain * (f32::from(px[k]) * alpha + 90.0 * (1.0 - alpha))) as u8)
        };
        p.pixels = p.pixels.chunks_exact(4).flat_map(over).collect();
        p.channels = 3;
    }
    c
}

#[test]
fn exposures_explain_uneven_photographs_and_resume() {
    let capture = unevenly_exposed(48);
    let start = initial_splats(&seeds(&capture, 600, 3));
    let make = |exposure: bool| {
        let mut o = options(&capture, Method::Vanilla, 150);
        o.exposure = exposure.then(ExposureRates::default);
        o.background = Background::Fixed([0.35; 3]);
        Trainer::new(capture.train.clone(), start.clone(), o)
    };
    let last = |t: &mut Trainer| {
        let mut l1 = 0.0;
        while !t.done() {
            let report = t.step();
            l1 += if report.step > 130 { report.l1 / 20.0 } else { 0.0 };
        }
        l1
    };
    let without = last(&mut make(false));
    let mut whole = make(true);
    let mut saved = Vec::new();
    while whole.step_count() < 77 {
        whole.step();
    }
    whole.save(&mut saved).unwrap();
    let with = last(&mut whole);
    assert!(with < 0.7 * without, "{with} {without}");
    let mut resumed = make(true);
    resumed.load(&mut &saved[..], saved.len() as u64).unwrap();
    last(&mut resumed);
    same(whole.splats(), resumed.splats());
    assert!(make(false).load(&mut &saved[..], saved.len() as u64).is_err());
}

#[test]
fn pruning_by_its_cost_keeps_the_looks() {
    let capture = capture(48);
    let mut o = options(&capture, Method::PgsrPrune, 120);
    o.prune_auto = true;
    o.prune = vec![PruneEvent { step: 100, tau: 0.1 }];
    let mut t = Trainer::new(capture.train.clone(), initial_splats(&seeds(&capture, 600, 3)), o);
    let mut chosen = None;
    while !t.done() {
        chosen = t.step().internal.or(chosen);
    }
    let (_, tau) = chosen.unwrap();
    assert!([0.0, 0.01, 0.02, 0.05, 0.1, 0.2].contains(&tau) && t.splats().len() > 50, "{chosen:?}");
    assert!(test_psnr(&mut t, &capture) > 20.0);
}

#[test]
fn nothing_stays_where_the_views_see_through() {
    let capture = capture(32);
    let mut o = options(&capture, Method::Vanilla, 20);
    let far = Vec::from_iter(capture.train.iter().map(|p| vec3::norm(vec3::sub(p.camera.center(), [0.0; 3])) - 1.0));
    o.clearance = far.iter().map(|d| 0.5 * d).collect();
    let mut start = initial_splats(&seeds(&capture, 300, 3));
    let before = start.len();
    // A floater a tenth of the way from the first camera to the torus.
    let eye = capture.train[0].camera.center();
    let mut floater = start.select(&[0]);
    floater.mean[0] = eye.map(|v| 0.9 * v);
    start.append(&floater);
    let mut t = Trainer::new(capture.train, start, o);
    while t.step_count() < 10 {
        t.step();
    }
    let near = t.splats().mean.iter().filter(|x| vec3::norm(vec3::sub(**x, eye)) < 0.4 * far[0]).count();
    assert!(near == 0 && t.splats().len() >= before, "{near} {}", t.splats().len());
}

#[test]
fn damaged_checkpoints_are_refused_and_change_nothing() {
    let mut t = trainer(32, Method::Ours, 40);
    t.step();
    let mut saved = Vec::new();
    t.save(&mut saved).unwrap();
    t.step();
    let before = t.export();
    let mut huge = saved.clone();
    huge[8..16].copy_from_slice(&u64::MAX.to_le_bytes());
    let cut = &saved[..saved.len() / 2];
    let mut text = saved.clone();
    text[17] = 0xff;
    for bad in [&b"short"[..], &[0; 64], cut, &huge, &text] {
        assert!(t.load(&mut &bad[..], bad.len() as u64).is_err());
        // A length that lies is found while reading.
        assert!(t.load(&mut &bad[..], saved.len() as u64).is_err());
    }
    let mut other = trainer(32, Method::Vanilla, 40);
    let message = other.load(&mut &saved[..], saved.len() as u64).unwrap_err().to_string();
    assert!(message.contains("method") && message.contains("weights"), "{message}");
    same(&before, &t.export());
    assert_eq!(t.step_count(), 2);
}

#[test]
fn multi_view_terms_and_sampling_train_too() {
    let capture = capture(48);
    let start = initial_splats(&seeds(&capture, 600, 3));
    for (pairs, mcmc) in [(true, None), (false, Some(Mcmc::default()))] {
        let mut o = options(&capture, Method::Pgsr, 120);
        (o.weights.geometric, o.weights.ncc) = if pairs { (0.03, 0.15) } else { (0.0, 0.0) };
        o.mcmc = mcmc;
        if let Some(r) = &mut o.refinement {
            r.most = 800;
        }
        let mut t = Trainer::new(capture.train.clone(), start.clone(), o);
        let mut first = 0.0;
        while !t.done() {
            let report = t.step();
            first = if report.step == 1 { report.l1 } else { first };
            assert!(report.loss.is_finite() && report.gaussians <= 800 && report.gaussians > 100, "{report:?}");
        }
        let last = t.step().l1;
        assert!(last < 0.5 * first, "{first} {last}");
    }
}

#[test]
fn self_fine_tuning_removes_needles_and_keeps_the_looks() {
    // A torus of long needles, as carelessly trained models have them.
    let mut shell = TORUS.shell(&megas_metrics::assets::Shell::default());
    for l in &mut shell.log_scale {
        *l = [l[0] + 0.9, l[1] - 0.9, l[2].min(l[1] - 1.0)];
    }
    let finetune = FinetuneOptions { iterations: 80, views: 12, test_views: 3, size: 64, most: 20_000, ..FinetuneOptions::default() };
    let teacher = Teacher::new(&shell, &finetune, |_, _| {});
    let options = teacher.options(&finetune);
    let (mut t, test) = teacher.student(&shell, options);
    while !t.done() {
        t.step();
    }
    let capture = Capture { train: Vec::new(), test, points: None, kind: "teacher", notes: Vec::new() };
    let psnr = test_psnr(&mut t, &capture);
    let needles = |s: &Splats| {
        let long = s.log_scale.iter().filter(|l| {
            let mut s = **l;
            s.sort_by(f32::total_cmp);
            s[2] - s[1] > 2.2f32.ln()
        });
        long.count() as f64 / s.len() as f64
    };
    assert!(needles(&shell) > 0.9 && needles(t.splats()) < 0.02, "{}", needles(t.splats()));
    assert!(psnr > 25.0, "{psnr}");
}
