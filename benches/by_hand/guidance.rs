//! Handwritten step and VJP of herding as in the paper: friction, drivers that repel each other,
//! evaders that flee and flock.

use arrayvec::ArrayVec;
use physgrad::effect::HasModel;
use physgrad::rng::Rng;
use physgrad::tasks::{Evade, Flock, Friction, GuidanceSystem, Spread};
use physgrad::{Cotangent, Cotangents, Float, Inputs, Real, Scalar, Start, System};

/// [`GuidanceSystem::herding`] for at most 32 agents. The reference point of the controls is the
/// sum of the evaders' positions.
#[derive(Clone)]
pub struct ByHand {
    pub system: GuidanceSystem,
    pub friction: Friction,
    pub spread: Spread,
    pub evade: Evade,
    pub flock: Flock,
}

/// Numbers per agent: x, y, vx, vy.
const AGENT: usize = 4;

/// Quantities of the separation r of two agents: r / d, |r| / d, 1 / d and r / |r|, with the
/// distance d = softening + |r|.
struct Gap<T> {
    share: [T; 2],
    length_share: T,
    per_distance: T,
    direction: [T; 2],
}

/// Force law `(far / d + near / d²) r`.
#[derive(Clone, Copy)]
struct Law<T> {
    far: T,
    near: T,
}

impl<T: Scalar> Gap<T> {
    /// Quantities of the separation from agent `a` to agent `b`. Rescales the separation where
    /// squares would overflow or lose digits.
    #[inline(always)]
    fn new(x: &[T], a: usize, b: usize, softening: T) -> Self {
        let (range, shift) = if T::Real::EPSILON < 1e-10 { (500, 600) } else { (60, 90) };
        let (huge, tiny) = (T::from(power_of_two(range)), T::from(power_of_two(-range)));
        let (up, down) = (T::from(power_of_two(shift)), T::from(power_of_two(-shift)));
        let (zero, one) = (T::zero(), T::one());
        let (x, y) = (x[AGENT * b] - x[AGENT * a], x[AGENT * b + 1] - x[AGENT * a + 1]);
        let largest = x.abs().max(y.abs()).detach();
        let unit = T::select_lt(huge, largest, down, one);
        let (x, y) = (x * unit, y * unit);
        let enlarged = T::select_lt(largest, tiny, up, one);
        let reduced = T::select_lt(largest, tiny, down, one);
        let (near_x, near_y) = (x * enlarged, y * enlarged);
        let square = near_x * near_x + near_y * near_y;
        let root = T::select_lt(zero, square, square, one).sqrt();
        let length = T::select_lt(zero, square, root * reduced, zero);
        let per_length = one / (softening * unit + length);
        let per_root = one / root;
        Self {
            share: [x * per_length, y * per_length],
            length_share: length * per_length,
            per_distance: unit * per_length,
            direction: [near_x * per_root, near_y * per_root],
        }
    }

    #[inline(always)]
    fn force(&self, law: Law<T>) -> [T; 2] {
        let strength = law.far + law.near * self.per_distance;
        [self.share[0] * strength, self.share[1] * strength]
    }
}

impl<R: Real> Gap<R> {
    #[inline(always)]
    fn force_vjp<C: Cotangent<R>>(&self, law: Law<R>, force_bar: [C; 2]) -> [C; 2] {
        let (far, near) = (law.far, law.near * self.per_distance);
        let across = (far + near) * self.per_distance;
        let along = -((far + near + near) * self.per_distance * self.length_share);
        let [x, y] = self.direction;
        let radial = (force_bar[0] * x + force_bar[1] * y) * along;
        [force_bar[0] * across + radial * x, force_bar[1] * across + radial * y]
    }
}

const fn power_of_two(exponent: i32) -> f64 {
    f64::from_bits(((1023 + exponent) as u64) << 52)
}

impl ByHand {
    /// Returns the force laws of spreading, evading and flocking.
    #[inline(always)]
    fn laws<T: Scalar>(&self) -> [Law<T>; 3] {
        let law = |far, near| Law { far: T::from(far), near: T::from(near) };
        let flock = self.flock;
        [
            law(0.0, self.spread.strength),
            law(0.0, self.evade.strength),
            law(flock.strength, -flock.strength * flock.distance),
        ]
    }

    /// Returns the sum of the evaders' positions.
    #[inline(always)]
    fn herd<T: Scalar>(&self, x: &[T]) -> [T; 2] {
        let mut sum = [T::zero(); 2];
        for evader in x[AGENT * self.system.drivers..].chunks_exact(AGENT) {
            sum[0] += evader[0];
            sum[1] += evader[1];
        }
        sum
    }
}

impl System for ByHand {
    fn state_dim(&self) -> usize {
        AGENT * (self.system.drivers + self.system.evaders)
    }

    fn control_dim(&self) -> usize {
        2 * self.system.drivers
    }

    #[inline(always)]
    fn step<T: Scalar>(&self, Inputs { x, u, .. }: Inputs<'_, T>, next: &mut [T]) {
        let (drivers, agents) = (self.system.drivers, self.system.drivers + self.system.evaders);
        let (softening, [spread, evade, flock]) =
            (T::from(self.system.softening), self.laws::<T>());
        // Stores accelerations in the velocity components of `next`.
        let herd = self.herd(x);
        let friction = T::from(self.friction.drivers);
        for ((next, x), c) in
            next.chunks_exact_mut(AGENT).zip(x.chunks_exact(AGENT)).zip(u.chunks_exact(2))
        {
            let q = [x[0] - herd[0], x[1] - herd[1]];
            next[2] = c[0] * q[0] - c[1] * q[1] - friction * x[2];
            next[3] = c[0] * q[1] + c[1] * q[0] - friction * x[3];
        }
        let friction = T::from(-self.friction.evaders);
        for (next, x) in next.chunks_exact_mut(AGENT).zip(x.chunks_exact(AGENT)).skip(drivers) {
            (next[2], next[3]) = (friction * x[2], friction * x[3]);
        }
        for b in 0..agents {
            let mut applied = [next[AGENT * b + 2], next[AGENT * b + 3]];
            for a in 0..b {
                let own = (a < drivers) == (b < drivers);
                let law = if !own {
                    evade
                } else if b < drivers {
                    spread
                } else {
                    flock
                };
                let [x, y] = Gap::new(x, a, b, softening).force(law);
                applied[0] += x;
                applied[1] += y;
                if own {
                    next[AGENT * a + 2] -= x;
                    next[AGENT * a + 3] -= y;
                }
            }
            (next[AGENT * b + 2], next[AGENT * b + 3]) = (applied[0], applied[1]);
        }
        let dt = T::from(self.system.dt);
        for (next, x) in next.chunks_exact_mut(AGENT).zip(x.chunks_exact(AGENT)) {
            (next[0], next[1]) = (x[0] + dt * x[2], x[1] + dt * x[3]);
            (next[2], next[3]) = (x[2] + dt * next[2], x[3] + dt * next[3]);
        }
    }

    #[inline(always)]
    fn vjp<R: Real, C: Cotangent<R>>(
        &self,
        Inputs { x, u, .. }: Inputs<'_, R>,
        next_bar: &[C],
        cotangents: Cotangents<'_, C>,
    ) {
        // Scratch for cotangents that are not requested.
        let (mut x_scratch, mut u_scratch) = (ArrayVec::<C, 128>::new(), ArrayVec::<C, 64>::new());
        let x_bar = cotangents.x.unwrap_or_else(|| {
            x_scratch.extend(x.iter().map(|_| C::null()));
            &mut x_scratch[..]
        });
        let u_bar = cotangents.u.unwrap_or_else(|| {
            u_scratch.extend(u.iter().map(|_| C::null()));
            &mut u_scratch[..]
        });
        let (drivers, agents) = (self.system.drivers, self.system.drivers + self.system.evaders);
        let (softening, [spread, evade, flock]) =
            (R::from(self.system.softening), self.laws::<R>());
        let dt = R::from(self.system.dt);
        let kept = [self.friction.drivers, self.friction.evaders]
            .map(|friction| R::from(1.0 - self.system.dt * friction));
        let mut forces_bar: ArrayVec<[C; 2], 32> = ArrayVec::new();
        for (agent, (bar, next)) in
            x_bar.chunks_exact_mut(AGENT).zip(next_bar.chunks_exact(AGENT)).enumerate()
        {
            let kept = if agent < drivers { kept[0] } else { kept[1] };
            forces_bar.push([next[2] * dt, next[3] * dt]);
            bar[0] += next[0];
            bar[1] += next[1];
            bar[2] += next[2] * kept + next[0] * dt;
            bar[3] += next[3] * kept + next[1] * dt;
        }
        let (herd, mut herd_bar) = (self.herd(x), [C::null(); 2]);
        for agent in 0..drivers {
            let (force, x, c) =
                (forces_bar[agent], &x[AGENT * agent..], &u[2 * agent..2 * agent + 2]);
            let q = [x[0] - herd[0], x[1] - herd[1]];
            u_bar[2 * agent] += force[0] * q[0] + force[1] * q[1];
            u_bar[2 * agent + 1] += force[1] * q[0] - force[0] * q[1];
            let q_bar = [force[0] * c[0] + force[1] * c[1], force[1] * c[0] - force[0] * c[1]];
            for axis in 0..2 {
                x_bar[AGENT * agent + axis] += q_bar[axis];
                herd_bar[axis] -= q_bar[axis];
            }
        }
        for bar in x_bar[AGENT * drivers..].chunks_exact_mut(AGENT) {
            bar[0] += herd_bar[0];
            bar[1] += herd_bar[1];
        }
        for b in 0..agents {
            let mut applied = [x_bar[AGENT * b], x_bar[AGENT * b + 1]];
            for a in 0..b {
                let own = (a < drivers) == (b < drivers);
                let law = if !own {
                    evade
                } else if b < drivers {
                    spread
                } else {
                    flock
                };
                let mut force_bar = forces_bar[b];
                if own {
                    force_bar[0] -= forces_bar[a][0];
                    force_bar[1] -= forces_bar[a][1];
                }
                let [x, y] = Gap::new(x, a, b, softening).force_vjp(law, force_bar);
                applied[0] += x;
                applied[1] += y;
                x_bar[AGENT * a] -= x;
                x_bar[AGENT * a + 1] -= y;
            }
            (x_bar[AGENT * b], x_bar[AGENT * b + 1]) = (applied[0], applied[1]);
        }
    }
}

impl HasModel<GuidanceSystem> for ByHand {
    #[inline(always)]
    fn model(&self) -> &GuidanceSystem {
        &self.system
    }

    fn start_extra(&self, _rng: &mut Rng, _start: Start<'_>) {}
}
