//! Lines and the nodes where they meet, and what is done to them: spurs are pruned, crossings resolved, gaps bridged.
//!
//! A crossing is two lines that lie over each other in projection: its four arms continue each other two by two. A
//! junction is where arms end. Lengths are in px; a line's points leave out the positions of its nodes.

use std::collections::BTreeMap;

use crate::geometry::{Point2, Vector2};

/// Largest bend of a line that passes through a crossing: cos 32 degrees.
const STRAIGHT_ON: f64 = 0.848;
/// Largest angle between a free end's direction and the gap it is bridged by: cos 32 degrees.
const AHEAD: f64 = 0.848;

/// What a line ends at.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum End {
    Free,
    Node(usize),
}

/// A polyline between two ends.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Line {
    pub points: Vec<Point2>,
    pub ends: [End; 2],
    pub closed: bool,
}

impl Line {
    fn reversed(mut self) -> Self {
        self.points.reverse();
        self.ends.reverse();
        self
    }
}

/// Lines by index (`None` where one was removed) and nodes.
#[derive(Clone, Debug, Default)]
pub(super) struct Network {
    pub lines: Vec<Option<Line>>,
    pub nodes: Vec<Point2>,
    /// Lines and which of their ends are at each node.
    arms: Vec<Vec<(usize, usize)>>,
    /// Typical width of a line, px.
    width_px: f64,
}

impl Network {
    pub fn new(nodes: Vec<Point2>, width_px: f64) -> Self {
        Self { lines: Vec::new(), arms: vec![Vec::new(); nodes.len()], nodes, width_px }
    }

    /// Adds a line and returns its index.
    pub fn add(&mut self, line: Line) -> usize {
        let index = self.lines.len();
        for (end, at) in line.ends.iter().enumerate() {
            if let End::Node(node) = at {
                self.arms[*node].push((index, end));
            }
        }
        self.lines.push(Some(line));
        index
    }

    fn remove(&mut self, index: usize) -> Option<Line> {
        let line = self.lines[index].take()?;
        for at in line.ends {
            if let End::Node(node) = at {
                self.arms[node].retain(|(line, _)| *line != index);
            }
        }
        Some(line)
    }

    /// Number of line ends at a node.
    pub fn degree(&self, node: usize) -> usize {
        self.arms[node].len()
    }

    fn live(&self) -> impl Iterator<Item = (usize, &Line)> {
        self.lines.iter().enumerate().filter_map(|(index, line)| Some((index, line.as_ref()?)))
    }

    fn end_position(&self, line: &Line, end: usize) -> Point2 {
        match line.ends[end] {
            End::Node(node) => self.nodes[node],
            End::Free if end == 0 => line.points[0],
            End::Free => line.points[line.points.len() - 1],
        }
    }

    /// Length with the stretches to the nodes.
    pub fn length(&self, line: &Line) -> f64 {
        let inner = crate::geometry::length2(&line.points);
        let (Some(first), Some(last)) = (line.points.first(), line.points.last()) else { return 0.0 };
        let closing = if line.closed { (last - first).norm() } else { 0.0 };
        inner + closing + (self.end_position(line, 0) - first).norm() + (self.end_position(line, 1) - last).norm()
    }

    /// Unit direction of a line away from one of its ends, measured where the end itself does not disturb it, and the
    /// point it is measured at.
    fn direction(&self, line: &Line, end: usize) -> (Point2, Vector2) {
        let at_node = matches!(line.ends[end], End::Node(_));
        let skip = if at_node { 0.8 * self.width_px } else { 0.3 * self.width_px };
        let reach = skip + (2.0 * self.width_px).max(7.0);
        let mut arc = 0.0;
        let mut previous = self.end_position(line, end);
        let mut near = Vec::new();
        let count = line.points.len();
        for place in 0..count {
            let point = line.points[if end == 0 { place } else { count - 1 - place }];
            arc += (point - previous).norm();
            previous = point;
            if arc > reach && near.len() > 1 {
                break;
            }
            if arc >= skip || count - place <= 3 {
                near.push(point);
            }
        }
        let start = near.first().copied().unwrap_or(previous);
        // From the mean of the nearer half to that of the farther one: steadier than the end points alone.
        let half = near.len() / 2;
        let mean = |points: &[Point2]| {
            points.iter().fold(Vector2::zeros(), |sum, point| sum + point.coords) / points.len().max(1) as f64
        };
        let direction = if half == 0 {
            start - self.end_position(line, end)
        } else {
            mean(&near[near.len() - half..]) - mean(&near[..half])
        };
        (start, direction.try_normalize(1e-9).unwrap_or_else(Vector2::x))
    }

    /// Joins two line ends; points within `trim_px` of the joint are left out (a skeleton is bent there).
    fn join(&mut self, (a, end_a): (usize, usize), (b, end_b): (usize, usize), trim_px: f64) {
        if a == b {
            if let Some(mut line) = self.remove(a) {
                // A loop that comes back to its own node.
                line.ends = [End::Free, End::Free];
                line.closed = line.points.len() > 2;
                self.add(line);
            }
            return;
        }
        let (Some(first), Some(second)) = (self.remove(a), self.remove(b)) else { return };
        let first = if end_a == 0 { first.reversed() } else { first };
        let second = if end_b == 0 { second } else { second.reversed() };
        let trimmed = |mut points: Vec<Point2>| {
            let mut arc = 0.0;
            while points.len() > 2 && arc < trim_px {
                let last = points.len() - 1;
                arc += (points[last] - points[last - 1]).norm();
                points.pop();
            }
            points
        };
        let mut points = trimmed(first.points);
        let mut rest = second.points;
        rest.reverse();
        rest = trimmed(rest);
        rest.reverse();
        points.extend(rest);
        self.add(Line { points, ends: [first.ends[0], second.ends[1]], closed: false });
    }

    /// Joins the two lines of a node that only two lines are left of.
    fn heal(&mut self, node: usize) {
        if let [a, b] = self.arms[node][..] {
            self.join(a, b, 0.0);
        }
    }

    /// Removes lines with one free end that are shorter than `shortest_px`, the shortest first.
    pub fn prune_spurs(&mut self, shortest_px: f64) {
        loop {
            let mut spurs: Vec<(f64, usize)> = self
                .live()
                .filter(|(_, line)| matches!(line.ends, [End::Free, End::Node(_)] | [End::Node(_), End::Free]))
                .map(|(index, line)| (self.length(line), index))
                .filter(|(length, _)| *length < shortest_px)
                .collect();
            if spurs.is_empty() {
                return;
            }
            spurs.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
            for (_, index) in spurs {
                // Healing a node may have used the line up.
                let Some(line) = self.remove(index) else { continue };
                for end in line.ends {
                    if let End::Node(node) = end {
                        self.heal(node);
                    }
                }
            }
        }
    }

    /// Resolves pairs of three-armed junctions that are one crossing drawn out, then junctions of four and more arms.
    pub fn resolve_crossings(&mut self) {
        // The flattest crossing that is told from two junctions: about 20 degrees.
        let longest = 10.0 * self.width_px;
        let mut links: Vec<(f64, usize)> = self
            .live()
            .filter(|(_, line)| matches!(line.ends, [End::Node(a), End::Node(b)] if a != b))
            .map(|(index, line)| (self.length(line), index))
            .filter(|(length, _)| *length < longest)
            .collect();
        links.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        for (_, link) in links {
            self.resolve_link(link);
        }
        for node in 0..self.nodes.len() {
            self.resolve_node(node);
        }
    }

    fn resolve_link(&mut self, link: usize) {
        let Some(Line { ends: [End::Node(a), End::Node(b)], .. }) = self.lines[link] else { return };
        let others = |node: usize| -> Vec<(usize, usize)> {
            self.arms[node].iter().copied().filter(|(line, _)| *line != link).collect()
        };
        let (from_a, from_b) = (others(a), others(b));
        if from_a.len() != 2 || from_b.len() != 2 {
            return;
        }
        let fit = |one: (usize, usize), other: (usize, usize)| self.continuity(one, other);
        let straight = fit(from_a[0], from_b[0]).min(fit(from_a[1], from_b[1]));
        let swapped = fit(from_a[0], from_b[1]).min(fit(from_a[1], from_b[0]));
        // Two lines that cross at an angle are one in the mask over a length of 2 half-widths / tan(angle / 2).
        let heading = |(line, end): (usize, usize)| self.lines[line].as_ref().map(|line| self.direction(line, end).1);
        let (Some(u), Some(v)) = (heading(from_a[0]), heading(from_a[1])) else { return };
        let half_angle = 0.5 * u.dot(&v).clamp(-1.0, 1.0).acos();
        let trim_px = self.bent_px(2.0 * half_angle);
        let merged_px = 1.6 * self.width_px / half_angle.tan().max(1e-3) + 2.0;
        let length = self.lines[link].as_ref().map_or(0.0, |line| self.length(line));
        if straight.max(swapped) < STRAIGHT_ON || length > merged_px {
            return;
        }
        let pairs = if straight >= swapped { [(0, 0), (1, 1)] } else { [(0, 1), (1, 0)] };
        self.remove(link);
        for (one, other) in pairs {
            // A line with both arms here changes its index when it is joined: look the arms up afresh.
            let at_a = self.arms[a].iter().position(|arm| *arm == from_a[one]);
            let at_b = self.arms[b].iter().position(|arm| *arm == from_b[other]);
            let (arm_a, arm_b) = match (at_a, at_b) {
                (Some(at_a), Some(at_b)) => (self.arms[a][at_a], self.arms[b][at_b]),
                _ => match (self.arms[a].first(), self.arms[b].first()) {
                    (Some(arm_a), Some(arm_b)) => (*arm_a, *arm_b),
                    _ => return,
                },
            };
            self.join(arm_a, arm_b, trim_px);
        }
    }

    /// Cosine of the bend from one arm to another; -1 where they are parallel but do not meet.
    fn continuity(&self, (a, end_a): (usize, usize), (b, end_b): (usize, usize)) -> f64 {
        let (Some(first), Some(second)) = (&self.lines[a], &self.lines[b]) else { return -1.0 };
        let ((from, u), (to, v)) = (self.direction(first, end_a), self.direction(second, end_b));
        let across = (to - from).perp(&u).abs().min((to - from).perp(&v).abs());
        if across > 1.0 * self.width_px + 2.0 { -1.0 } else { -u.dot(&v) }
    }

    /// How far from a crossing at an angle the crests of two lines pull at each other.
    fn bent_px(&self, angle_rad: f64) -> f64 {
        (0.9 * self.width_px / angle_rad.sin().abs().max(0.1)).clamp(self.width_px, 4.0 * self.width_px)
    }

    fn resolve_node(&mut self, node: usize) {
        loop {
            let arms = self.arms[node].clone();
            let fit = |a: usize, b: usize| self.continuity(arms[a], arms[b]);
            if arms.len() == 4 {
                let pairings = [[(0, 1), (2, 3)], [(0, 2), (1, 3)], [(0, 3), (1, 2)]];
                let worst = |pairs: &[(usize, usize); 2]| fit(pairs[0].0, pairs[0].1).min(fit(pairs[1].0, pairs[1].1));
                let Some(best) = pairings.iter().max_by(|a, b| worst(a).total_cmp(&worst(b))) else { return };
                if worst(best) < STRAIGHT_ON {
                    return;
                }
                let [(a, b), (c, _)] = *best;
                let heading =
                    |(line, end): (usize, usize)| self.lines[line].as_ref().map(|line| self.direction(line, end).1);
                let (Some(u), Some(v)) = (heading(arms[a]), heading(arms[c])) else { return };
                let trim_px = self.bent_px(u.dot(&v).clamp(-1.0, 1.0).acos());
                self.join(arms[a], arms[b], trim_px);
                if let [a, b] = self.arms[node][..] {
                    self.join(a, b, trim_px);
                }
                return;
            }
            if arms.len() < 5 {
                return;
            }
            // More lines than two: the straightest pass through until three or four arms are left.
            let pairs = (0..arms.len()).flat_map(|a| (a + 1..arms.len()).map(move |b| (a, b)));
            let Some((a, b)) = pairs.max_by(|x, y| fit(x.0, x.1).total_cmp(&fit(y.0, y.1))) else { return };
            if fit(a, b) < STRAIGHT_ON {
                return;
            }
            self.join(arms[a], arms[b], self.width_px);
        }
    }

    /// Bridges gaps of up to `longest_px` between free ends that point at each other.
    pub fn bridge_gaps(&mut self, longest_px: f64) {
        let ends = self.free_ends();
        let mut grid = BTreeMap::<(i64, i64), Vec<usize>>::new();
        let cell = |point: &Point2| ((point.x / longest_px).floor() as i64, (point.y / longest_px).floor() as i64);
        for (index, end) in ends.iter().enumerate() {
            grid.entry(cell(&end.position)).or_default().push(index);
        }
        let mut bridges = Vec::new();
        for (index, end) in ends.iter().enumerate() {
            let (column, row) = cell(&end.position);
            for near in (column - 1..=column + 1).flat_map(|c| (row - 1..=row + 1).map(move |r| (c, r))) {
                for &other_index in grid.get(&near).into_iter().flatten() {
                    let other = &ends[other_index];
                    if other_index <= index {
                        continue;
                    }
                    let gap = other.position - end.position;
                    let distance = gap.norm();
                    let facing = -end.outward.dot(&other.outward);
                    // Over a px or two the direction of the gap itself says nothing.
                    let ahead = if distance < 2.5 {
                        1.0
                    } else {
                        (end.outward.dot(&gap)).min(-other.outward.dot(&gap)) / distance
                    };
                    let same = end.line == other.line;
                    let long_enough = !same || self.lines[end.line].as_ref().is_some_and(|l| l.points.len() > 12);
                    if distance <= longest_px && facing > STRAIGHT_ON && ahead > AHEAD && long_enough {
                        bridges.push((distance * (3.0 - facing - ahead), index, other_index));
                    }
                }
            }
        }
        bridges.sort_by(|a, b| a.0.total_cmp(&b.0).then((a.1, a.2).cmp(&(b.1, b.2))));
        let mut used = vec![false; ends.len()];
        // Which line and end each free end belongs to now.
        let mut now: Vec<(usize, usize)> = ends.iter().map(|end| (end.line, end.end)).collect();
        for (_, a, b) in bridges {
            if used[a] || used[b] {
                continue;
            }
            (used[a], used[b]) = (true, true);
            let (first, second) = (now[a], now[b]);
            let far = |(line, end): (usize, usize)| (line, 1 - end);
            let far_ends = [far(first), far(second)];
            self.join(first, second, 0.0);
            let joined = self.lines.len() - 1;
            for place in now.iter_mut() {
                if *place == far_ends[0] {
                    *place = (joined, 0);
                } else if *place == far_ends[1] {
                    *place = (joined, 1);
                }
            }
        }
    }

    fn free_ends(&self) -> Vec<FreeEnd> {
        self.live()
            .filter(|(_, line)| !line.closed)
            .flat_map(|(index, line)| {
                [0, 1].into_iter().filter(|end| line.ends[*end] == End::Free).map(move |end| FreeEnd {
                    line: index,
                    end,
                    position: self.end_position(line, end),
                    outward: -self.direction(line, end).1,
                })
            })
            .collect()
    }

    /// Lets free ends that run into the side of another line within `longest_px` meet it in a new junction.
    pub fn attach_ends(&mut self, longest_px: f64) {
        const CELL_PX: f64 = 16.0;
        let cell = |point: &Point2| ((point.x / CELL_PX).floor() as i64, (point.y / CELL_PX).floor() as i64);
        let mut grid = BTreeMap::<(i64, i64), Vec<(usize, Point2)>>::new();
        for (index, line) in self.live() {
            for point in &line.points {
                grid.entry(cell(point)).or_default().push((index, *point));
            }
        }
        let reach = (longest_px / CELL_PX).ceil() as i64;
        for end in self.free_ends() {
            // Lines change as ends are attached: an end whose line is no longer there under its index waits for none.
            let Some(own) = &self.lines[end.line] else { continue };
            if own.ends[end.end] != End::Free {
                continue;
            }
            let (column, row) = cell(&end.position);
            let target = (column - reach..=column + reach)
                .flat_map(|c| (row - reach..=row + reach).map(move |r| (c, r)))
                .filter_map(|near| grid.get(&near))
                .flatten()
                .filter(|(line, _)| *line != end.line && self.lines[*line].is_some())
                .map(|(line, point)| (point - end.position, *line, *point))
                .filter(|(gap, ..)| gap.norm() <= longest_px && end.outward.dot(gap) > AHEAD * gap.norm())
                .min_by(|a, b| a.0.norm().total_cmp(&b.0.norm()));
            if let Some((_, line, point)) = target {
                self.split_at(line, point, (end.line, end.end));
            }
        }
    }

    /// Splits a line at one of its points and makes that a node with the given end; at an end of the line, joins it.
    fn split_at(&mut self, line: usize, point: Point2, (other, other_end): (usize, usize)) {
        let Some(target) = &self.lines[line] else { return };
        let Some(place) = target.points.iter().position(|candidate| *candidate == point) else { return };
        let count = target.points.len();
        let near_end = 3;
        if !target.closed && (place < near_end || place + near_end >= count) {
            // Ends that face each other were looked at before; a node at the very end adds nothing.
            return;
        }
        let Some(target) = self.remove(line) else { return };
        let Some(mut attached) = self.remove(other) else { return };
        let node = self.nodes.len();
        self.nodes.push(point);
        self.arms.push(Vec::new());
        let (before, after) = (&target.points[..place], &target.points[place + 1..]);
        if target.closed {
            let points = after.iter().chain(before).copied().collect();
            self.add(Line { points, ends: [End::Node(node), End::Node(node)], closed: false });
        } else {
            self.add(Line { points: before.to_vec(), ends: [target.ends[0], End::Node(node)], closed: false });
            self.add(Line { points: after.to_vec(), ends: [End::Node(node), target.ends[1]], closed: false });
        }
        attached.ends[other_end] = End::Node(node);
        self.add(attached);
    }

    /// Removes connected groups of lines whose summed length is below `shortest_px`, and loops too small to be any.
    pub fn drop_short(&mut self, shortest_px: f64) {
        let mut group: Vec<usize> = (0..self.lines.len()).collect();
        fn root(group: &mut [usize], mut index: usize) -> usize {
            while group[index] != index {
                group[index] = group[group[index]];
                index = group[index];
            }
            index
        }
        for arms in &self.arms {
            for pair in arms.windows(2) {
                let (a, b) = (root(&mut group, pair[0].0), root(&mut group, pair[1].0));
                group[a.max(b)] = a.min(b);
            }
        }
        let mut lengths = vec![0.0; self.lines.len()];
        let roots: Vec<usize> = (0..self.lines.len()).map(|index| root(&mut group, index)).collect();
        for (index, line) in self.live() {
            lengths[roots[index]] += self.length(line);
        }
        for index in 0..self.lines.len() {
            if lengths[roots[index]] < shortest_px {
                self.remove(index);
            }
        }
        for node in 0..self.nodes.len() {
            self.heal(node);
        }
    }
}

struct FreeEnd {
    line: usize,
    end: usize,
    position: Point2,
    outward: Vector2,
}
