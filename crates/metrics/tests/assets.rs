//! The ground-truth bodies against themselves: distances, normals, volumes, parts, photographs and splats.

use megas_math::{Vec3, rng::Rng, vec3};
use megas_metrics::assets::{METRES_PER_UNIT, Part, Shape, Shell, Solid, Sprinkle, Sundae, camera_rig, photograph, volume};
use megas_model::{Camera, Splats};

fn shapes() -> [Shape; 6] {
    [
        Shape::Sphere { radius: 0.5 },
        Shape::Torus { major: 0.4, minor: 0.15 },
        Shape::Cup { radius: 0.4, height: 0.8, wall: 0.1 },
        Shape::Blobs { radius: 0.3, distance: 0.5, blend: 0.2 },
        Shape::Dome { radius: 0.5 },
        Shape::Plate { half: [0.5, 0.4, 0.06] },
    ]
}

fn random_in(rng: &mut Rng, (lo, hi): (Vec3<f32>, Vec3<f32>), margin: f32) -> Vec3<f32> {
    std::array::from_fn(|a| rng.range(f64::from(lo[a] - margin), f64::from(hi[a] + margin)) as f32)
}

fn monte_carlo(solid: &impl Solid, samples: usize) -> f64 {
    let (lo, hi) = solid.bounds();
    let mut rng = Rng::new(11);
    let hits = (0..samples).filter(|_| solid.sdf(random_in(&mut rng, (lo, hi), 0.0)) < 0.0).count();
    let size = vec3::sub(hi, lo).map(f64::from);
    size[0] * size[1] * size[2] * hits as f64 / samples as f64
}

/// The object without the table, and its closed-in bounds.
struct Object<'a>(&'a Sundae);

impl Solid for Object<'_> {
    fn sdf(&self, x: Vec3<f32>) -> f32 {
        self.0.object_sdf(x)
    }
    fn bounds(&self) -> (Vec3<f32>, Vec3<f32>) {
        self.0.object_bounds()
    }
    fn albedo(&self, x: Vec3<f32>) -> [f32; 3] {
        self.0.albedo(x)
    }
}

#[test]
fn analytic_bodies_have_their_volumes_by_formula_grid_and_dice() {
    for s in shapes() {
        let grid = volume(&s, 96);
        let dice = monte_carlo(&s, 200_000);
        assert!((grid / dice - 1.0).abs() < 0.015, "{s:?}: {grid} {dice}");
        if let Some(exact) = s.exact_volume() {
            assert!((grid / exact - 1.0).abs() < 0.004, "{s:?}: {grid} {exact}");
        }
    }
    assert!(Shape::Blobs { radius: 0.3, distance: 0.5, blend: 0.2 }.exact_volume().is_none());
}

#[test]
fn distances_grow_no_faster_than_length_and_normals_are_their_gradient() {
    let mut rng = Rng::new(3);
    for s in shapes() {
        for _ in 0..3000 {
            let x = random_in(&mut rng, s.bounds(), 0.2);
            let y = vec3::add_scaled(x, rng.direction().map(|v| v as f32), 0.01);
            assert!((s.sdf(x) - s.sdf(y)).abs() <= 0.01 * 1.001 + 1e-6, "{s:?} at {x:?}");
        }
    }
    let scene = Sundae::new();
    let (mut near, mut steep, mut apart, mut worst) = (0, 0, 0, 0.0f32);
    for _ in 0..60_000 {
        let x = random_in(&mut rng, scene.object_bounds(), 0.02);
        if scene.sdf(x).abs() > 0.03 {
            continue;
        }
        let d = rng.direction().map(|v| v as f32);
        let slope = (scene.sdf(vec3::add_scaled(x, d, 2e-3)) - scene.sdf(vec3::add_scaled(x, d, -2e-3))).abs() / 4e-3;
        near += 1;
        steep += usize::from(slope > 1.35);
        worst = worst.max(slope);
        // Plain central differences say the same but on creases, where both average over two sides.
        let g: Vec3<f32> = std::array::from_fn(|a| {
            let mut e = [0.0; 3];
            e[a] = 1e-3;
            scene.sdf(vec3::add(x, e)) - scene.sdf(vec3::sub(x, e))
        });
        apart += usize::from(vec3::dot(vec3::normalize_or(g, [0.0; 3]), scene.normal(x)) < 0.95);
    }
    assert!(near > 3000, "{near}");
    // Relief may exceed slope 1 here and there, but the tracer's step of 0.75 must stay safe nearly everywhere.
    assert!(steep * 40 < near && worst < 2.6, "{steep} of {near}, worst {worst}");
    assert!(apart * 50 < near, "{apart} of {near}");
}

#[test]
fn parts_cover_the_inside_and_nothing_else() {
    let scene = Sundae::new();
    let mut rng = Rng::new(5);
    let mut seen = [0usize; 8];
    for _ in 0..60_000 {
        let x = random_in(&mut rng, scene.bounds(), 0.0);
        let d = scene.sdf(x);
        let part = scene.part(x);
        // The shortcuts of the union change nothing near the surface (only the filling of the bowl is not a part of its own).
        let least = Part::ALL.iter().map(|&p| scene.part_sdf(x, p)).fold(f32::INFINITY, f32::min);
        assert!(least.abs() > 0.03 || d < least + 1e-5, "{x:?}: {d} {least}");
        assert!(d.abs() > 0.03 || d > least - 1e-5 || x[2] < 0.5, "{x:?}: {d} {least}");
        if d < -0.01 {
            seen[part as usize] += 1;
            // Ice cream also fills the bowl between the scoops; every other part contains its points.
            let own = scene.part_sdf(x, part);
            assert!(part.is_ice_cream() || own < 0.0, "{part:?} at {x:?}: {own}");
            assert_eq!(part == Part::Table, x[2] < 0.0);
        } else if d > 0.01 {
            for p in Part::ALL {
                assert!(scene.part_sdf(x, p) > 0.0, "{p:?} at {x:?}");
            }
        }
    }
    assert!(seen.iter().all(|&n| n > 10), "{seen:?}");
}

#[test]
fn the_object_is_a_dish_of_ice_cream_of_believable_size() {
    let scene = Sundae::new();
    let object = Object(&scene);
    let (coarse, fine, dice) = (volume(&object, 48), volume(&object, 96), monte_carlo(&object, 100_000));
    assert!((coarse / fine - 1.0).abs() < 0.01 && (dice / fine - 1.0).abs() < 0.02, "{coarse} {fine} {dice}");
    let litres = fine * f64::from(METRES_PER_UNIT).powi(3) * 1000.0;
    assert!((0.4..1.5).contains(&litres), "{litres} l");
    // Nothing sticks out of the stated box.
    let (lo, hi) = scene.object_bounds();
    let mut rng = Rng::new(8);
    for _ in 0..20_000 {
        let x = random_in(&mut rng, (lo, hi), 0.1);
        let outside = (0..3).any(|a| x[a] < lo[a] || x[a] > hi[a]);
        assert!(!outside || scene.object_sdf(x) > 0.0, "{x:?}");
    }
}

fn in_pool<T: Send>(threads: usize, f: impl FnOnce() -> T + Send) -> T {
    rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool").install(f)
}

#[test]
fn photographs_are_the_same_for_any_number_of_threads_and_their_depth_lies_on_the_surface() {
    let camera = Camera::look_at([1.2, -4.0, 1.8], [0.0, 0.0, 0.5], [0.0, 0.0, 1.0], 0.6, 120, 90);
    let scene = Sundae::new();
    let a = in_pool(1, || photograph(&Sundae::new(), &camera, 2, "a"));
    let b = in_pool(3, || photograph(&scene, &camera, 2, "b"));
    assert!(a.image == b.image && a.depth == b.depth && a.normal == b.normal);
    let (depth, normal) = (b.depth.expect("depth"), b.normal.expect("normals"));
    let (mut hits, mut grey) = (0, 0);
    for y in 0..camera.height {
        for x in 0..camera.width {
            let alpha = b.image.pixel(x, y)[3];
            grey += usize::from(alpha > 0.0 && alpha < 1.0);
            let z = depth.pixel(x, y)[0];
            if !z.is_finite() {
                assert_eq!(normal.pixel(x, y), [0.0; 3]);
                continue;
            }
            hits += 1;
            let (o, d) = camera.ray(x as f32 + 0.5, y as f32 + 0.5);
            let p = vec3::add_scaled(o, d, z / vec3::dot(d, camera.rotation[2]));
            assert!(scene.sdf(p).abs() < 2e-3, "({x}, {y}): {} at {p:?} on {:?}", scene.sdf(p), scene.part(p));
            let n = normal.pixel(x, y);
            assert!((vec3::dot([n[0], n[1], n[2]], [n[0], n[1], n[2]]) - 1.0).abs() < 1e-4);
            assert!(vec3::dot([n[0], n[1], n[2]], d) < 0.35);
        }
    }
    assert!(hits > 2000 && grey > 50, "{hits} {grey}");
}

#[test]
fn the_rig_sees_everything_from_above_the_horizon() {
    let shape = Shape::Sphere { radius: 0.5 };
    let cameras = camera_rig(shape.bounds(), 12, 4, 64, 48);
    assert_eq!(cameras.len(), 16);
    for (i, c) in cameras.iter().enumerate() {
        assert!(c.center()[2] > 0.0);
        assert!(cameras[..i].iter().all(|o| vec3::norm(vec3::sub(o.center(), c.center())) > 0.05));
        let view = photograph(&shape, c, 1, "");
        let border = |x: u32, y: u32| x == 0 || y == 0 || x == 63 || y == 47;
        assert!((0..48).all(|y| (0..64).all(|x| !border(x, y) || view.image.pixel(x, y)[3] == 0.0)));
        assert!(view.image.pixel(32, 24)[3] == 1.0);
    }
}

fn least_distance(points: &[[f32; 3]], cell: f32) -> f32 {
    let mut grid = std::collections::HashMap::<[i32; 3], Vec<usize>>::new();
    let key = |p: &[f32; 3]| p.map(|v| (v / cell).floor() as i32);
    let mut least = f32::INFINITY;
    for (i, p) in points.iter().enumerate() {
        let k = key(p);
        for d in 0..27 {
            let near = grid.get(&[k[0] + d % 3 - 1, k[1] + d / 3 % 3 - 1, k[2] + d / 9 - 1]);
            for &j in near.into_iter().flatten() {
                least = least.min(vec3::norm(vec3::sub(points[j], *p)));
            }
        }
        grid.entry(k).or_default().push(i);
    }
    least
}

fn check_surface(splats: &Splats, sdf: impl Fn(Vec3<f32>) -> f32, spacing: f32) {
    let mut outward = 0;
    for i in 0..splats.len() {
        let (x, n) = (splats.mean[i], splats.normal(i));
        assert!(sdf(x).abs() < 0.02 * spacing, "{x:?}: {}", sdf(x));
        assert_eq!(splats.shortest_axis(i), 2);
        let step = 0.05 * spacing;
        outward += usize::from(sdf(vec3::add_scaled(x, n, step)) > sdf(vec3::add_scaled(x, n, -step)));
    }
    assert!(outward as f64 >= 0.999 * splats.len() as f64, "{outward} of {}", splats.len());
    assert!(least_distance(&splats.mean, spacing) >= spacing);
}

#[test]
fn sprinkled_splats_lie_on_the_surface_apart_from_each_other_and_face_outward() {
    let scene = Sundae::new();
    let settings = Sprinkle { spacing: 0.03, table_spacing: 0.06, ..Sprinkle::default() };
    let splats = in_pool(2, || scene.sprinkle(&settings));
    assert_eq!(splats, in_pool(1, || scene.sprinkle(&settings)));
    let part = |table: bool| {
        let of = |i: &usize| (splats.object_id[*i] == Part::Table as u16) == table;
        splats.select(&(0..splats.len()).filter(of).collect::<Vec<_>>())
    };
    check_surface(&part(false), |x| scene.object_sdf(x), settings.spacing);
    check_surface(&part(true), |x| scene.table_sdf(x), settings.table_spacing);
    for p in Part::ALL {
        assert!(splats.object_id.iter().filter(|&&o| o == p as u16).count() > 20, "{p:?}");
    }
    // Colours are colours, and the sauce is darker than the vanilla.
    let mean = |p: Part| {
        let of: Vec<usize> = (0..splats.len()).filter(|&i| splats.object_id[i] == p as u16).collect();
        of.iter().map(|&i| splats.base_rgb(i)[1]).sum::<f32>() / of.len() as f32
    };
    assert!((0..splats.len()).all(|i| splats.base_rgb(i).iter().all(|v| (-0.1..=1.1).contains(v))));
    assert!(mean(Part::Vanilla) > mean(Part::Sauce) + 0.3);
}

#[test]
fn shells_are_blue_noise_and_as_opaque_as_the_design_says() {
    for s in shapes() {
        let shell = s.shell(&Shell { spacing: 0.04, ..Shell::default() });
        check_surface(&shell, |x| s.sdf(x), 0.04);
        let bottom = shell.mean.iter().filter(|m| m[2] < 1e-3).count();
        assert!(!matches!(s, Shape::Dome { .. }) || bottom * 50 < shell.len(), "{bottom}");
    }
    // Mean alpha of rays from the middle of a sphere. Splatting.md §5.5 measured 0.82 and 0.96 at 0.5 discs per squared spacing;
    // these shells have no gaps left to fill, 0.7, and are more opaque.
    let sphere = Shape::Sphere { radius: 0.5 };
    for (size, low, high) in [(0.8f32, 0.88, 0.95), (1.1, 0.96, 0.999)] {
        let shell = sphere.shell(&Shell { spacing: 0.03, size, ..Shell::default() });
        let mut rng = Rng::new(2);
        let alpha = |d: Vec3<f32>| {
            let seen = (0..shell.len()).filter(|&i| vec3::dot(shell.mean[i], d) > 0.0).fold(1.0, |t, i| {
                let e = vec3::norm(vec3::cross(shell.mean[i], d)) / (size * 0.03);
                t * (1.0 - shell.opacity(i) * (-0.5 * e * e).exp())
            });
            1.0 - seen
        };
        let mean = (0..300).map(|_| alpha(rng.direction().map(|v| v as f32))).sum::<f32>() / 300.0;
        assert!((low..high).contains(&mean), "size {size}: {mean}");
    }
}
