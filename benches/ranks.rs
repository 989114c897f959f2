//! Model of the time of an update on several machines, with constants measured on this machine.
//!
//! Usage: `cargo bench --bench ranks -- [LATENCY µs] [BANDWIDTH Gbit/s] [CORES per machine]`, with
//! defaults 20, 10 and 32. Four poles, field C, f32. `docs/runs.md` explains the formula.
//!
//! Measures the gradient of a sample on one core, and the exchange of two ranks, which are threads
//! here. Latency, bandwidth and cores per machine are parameters.

mod measure;

use measure::{median, ratio, rounds};
use physgrad::engine::{Batch, Ranks};
use physgrad::policy::{Mlp, Policy};
use physgrad::rng::{Purpose, stream};
use physgrad::tasks::CartPole;
use physgrad::{Flow, Weights, initial_states};
use std::sync::{Arc, Barrier, Mutex};

const FLOWS: [Flow; 2] = [Flow::MODIFIED, Flow::REGULAR];
/// Number of samples whose gradients form one sum.
const GROUP: usize = 4;
/// Largest number of blocks of groups.
const BLOCKS: usize = 32;
/// Number of messages that a rank sends to each other rank in one update. Five exchanges
/// (divergence, blocks, total, costs, pause) send two each: length and contents.
const MESSAGES: f64 = 10.0;

/// One of two ranks, each a thread of this process.
#[derive(Debug)]
struct Threads {
    rank: usize,
    messages: Arc<Mutex<[Vec<Vec<u8>>; 2]>>,
    barrier: Arc<Barrier>,
}

impl Ranks for Threads {
    fn rank(&self) -> usize {
        self.rank
    }

    fn count(&self) -> usize {
        2
    }

    fn exchange(&self, messages: &[&[u8]]) -> Vec<Vec<u8>> {
        self.messages.lock().expect("no panic")[self.rank] =
            messages.iter().map(|message| message.to_vec()).collect();
        self.barrier.wait();
        let received = self
            .messages
            .lock()
            .expect("no panic")
            .iter()
            .map(|row| row[self.rank].clone())
            .collect();
        self.barrier.wait();
        received
    }
}

/// Constants of the model. Times in µs.
struct Model {
    params: f64,
    /// Time of the gradient of one sample on one core.
    sample: f64,
    /// Time to handle one number of a block sum: packing, copying, unpacking, adding.
    number: f64,
    latency: f64,
    /// Bytes per µs.
    bandwidth: f64,
    cores: usize,
}

impl Model {
    /// Time of the gradient of a mini-batch, without and with communication.
    fn update(&self, batch: usize, machines: usize) -> [f64; 2] {
        let groups = batch.div_ceil(GROUP);
        let block = groups.div_ceil(BLOCKS);
        // Number of blocks of the rank with the most blocks.
        let own = groups.div_ceil(block).div_ceil(machines);
        let compute = ((own * block).min(groups).div_ceil(self.cores) * GROUP) as f64 * self.sample;
        if machines == 1 {
            return [compute, compute];
        }
        let numbers = FLOWS.len() as f64 * self.params;
        let others = (machines - 1) as f64;
        let bytes = 4.0 * numbers * (own as f64 + 1.0) * others / machines as f64;
        let messages = MESSAGES * others * self.latency;
        let handling = numbers * own as f64 * self.number;
        [compute, compute + messages + bytes / self.bandwidth + handling]
    }
}

fn main() {
    let numbers: Vec<f64> = std::env::args().filter_map(|text| text.parse().ok()).collect();
    let given = |i: usize, default: f64| numbers.get(i).copied().unwrap_or(default);
    let (latency, gbit, cores) = (given(0, 20.0), given(1, 10.0), given(2, 32.0) as usize);
    let (task, policy) = (CartPole::new(4), Mlp::new([10, 64, 64, 1]));
    let weights = Weights::<f32>::init(&policy, &mut stream(0, Purpose::Policy, 0));
    let batch = 512;
    let starts: Vec<f32> = initial_states(&task, 0, Purpose::Train, batch);

    // Both measurements run two threads, so they load caches and memory equally.
    let pair = |work: &(dyn Fn(usize) -> Box<dyn FnMut() + Send> + Sync)| {
        let mut jobs = [work(0), work(1)];
        move || {
            std::thread::scope(|scope| jobs.iter_mut().for_each(|job| drop(scope.spawn(job))));
        }
    };
    let n = starts.len() / batch;
    let run = |mut own: Batch<f32>, starts: Vec<f32>| -> Box<dyn FnMut() + Send> {
        let (task, policy, weights) = (task, policy.clone(), weights.clone());
        Box::new(move || {
            own.run(&task, &policy, &weights, &starts).expect("finite");
        })
    };
    let alone = pair(&|rank| {
        let half = starts[rank * batch / 2 * n..][..batch / 2 * n].to_vec();
        run(Batch::new(&task, &policy, batch / 2, &FLOWS, 1), half)
    });
    let (messages, barrier) =
        (Arc::new(Mutex::new([Vec::new(), Vec::new()])), Arc::new(Barrier::new(2)));
    let together = pair(&|rank| {
        let ranks =
            Arc::new(Threads { rank, messages: messages.clone(), barrier: barrier.clone() });
        run(
            Batch::shared(ranks, &task, &policy, batch, &FLOWS, 1, None).expect("no limit"),
            starts.clone(),
        )
    });
    let (mut alone, mut together) = (alone, together);
    let times = rounds(20, &mut [&mut alone, &mut together]);
    let [alone, together] = [0, 1].map(|i| median(&times[i]));
    let params = policy.param_count() as f64;
    let own = (batch / GROUP).min(BLOCKS) as f64 / 2.0;
    let model = Model {
        params,
        sample: alone / (batch / 2) as f64,
        number: (together - alone).max(0.0) / (own * params * FLOWS.len() as f64),
        latency,
        bandwidth: gbit * 125.0,
        cores,
    };
    println!(
        "measured: gradient of a sample on one core {:.1} µs, {params} parameters",
        model.sample
    );
    println!(
        "measured: two ranks take {:.3} of the time without exchange",
        ratio(&times[1], &times[0])
    );
    println!("measured: handling of a number of a block {:.2} ns", model.number * 1e3);
    println!(
        "parameters: latency {latency} µs, bandwidth {gbit} Gbit/s, {cores} cores per machine, one rank per machine"
    );
    for (title, scaling) in
        [("strong: batch 8192", None), ("weak: batch 256 per machine", Some(256))]
    {
        println!("\n{title}\n  cores  machines  gradient ms  with exchange ms  efficiency");
        let of = |machines: usize| {
            model.update(scaling.map_or(8192, |batch| batch * machines), machines)
        };
        for machines in (0..).map(|i| 1 << i).take_while(|machines| machines * cores <= 1024) {
            let [compute, all] = of(machines);
            let ideal = of(1)[1] / if scaling.is_none() { machines as f64 } else { 1.0 };
            println!(
                "  {:>5}  {machines:>8}  {:>11.3}  {:>16.3}  {:>9.0}%",
                machines * cores,
                compute / 1e3,
                all / 1e3,
                100.0 * ideal / all
            );
        }
    }
    let pays = |batch: &usize| model.update(*batch, 2)[1] < model.update(*batch, 1)[1];
    match (1..=1 << 20).map(|groups| groups * GROUP).find(pays) {
        Some(batch) => println!("\na second machine pays from a batch of {batch}"),
        None => println!("\na second machine does not pay up to a batch of {}", GROUP << 20),
    }
}
