//! [`Shard`]: share of the runs of a comparison that one of several processes trains first.

use std::str::FromStr;

/// Number of a process among `count` processes, from 1 to `count`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shard {
    number: usize,
    count: usize,
}

impl FromStr for Shard {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let parts = text
            .split_once('/')
            .and_then(|(number, count)| Some((number.parse().ok()?, count.parse().ok()?)));
        let parts = parts.filter(|(number, count): &(u16, u16)| (1..=*count).contains(number));
        let (number, count) =
            parts.ok_or("allowed: K/N with K from 1 to N and N up to 65535, for example 3/16")?;
        Ok(Self { number: number.into(), count: count.into() })
    }
}

impl Shard {
    /// True for the first of all shards.
    pub fn is_first(self) -> bool {
        self.number == 1
    }

    /// Number of runs in the share.
    pub fn share(self, runs: usize) -> usize {
        (runs + self.count - self.number) / self.count
    }

    /// Order in which the process visits all runs: its share, then the shares of the following
    /// processes in cyclic order. Each share contains every `count`-th run.
    pub fn order(self, runs: usize) -> Vec<usize> {
        (0..self.count)
            .flat_map(|k| (0..runs).skip((self.number - 1 + k) % self.count).step_by(self.count))
            .collect()
    }
}

impl std::fmt::Display for Shard {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}/{}", self.number, self.count)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shards_visit_all_runs_and_start_with_disjoint_shares() {
        for (runs, count) in [(10, 3), (2, 5), (7, 1), (0, 2)] {
            let mut shares = Vec::new();
            for number in 1..=count {
                let shard = Shard { number, count };
                let mut order = shard.order(runs);
                shares.extend_from_slice(&order[..shard.share(runs)]);
                order.sort_unstable();
                assert_eq!(order, (0..runs).collect::<Vec<_>>());
            }
            shares.sort_unstable();
            assert_eq!(shares, (0..runs).collect::<Vec<_>>(), "{runs} runs, {count} shards");
        }
        assert_eq!("2/3".parse::<Shard>().expect("a shard").order(7), [1, 4, 2, 5, 0, 3, 6]);
    }

    #[test]
    fn numbers_outside_1_to_n_are_refused() {
        for text in ["0/4", "5/4", "1", "1/0", "a/2", "1/2/3", "", "1/65536"] {
            assert!(text.parse::<Shard>().is_err(), "{text}");
        }
    }
}
