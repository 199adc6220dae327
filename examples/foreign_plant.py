# SPDX-License-Identifier: Apache-2.0
"""A node in the plant's place: another simulator, in rclpy and Pinocchio, runs trials with our four other nodes.

Shows the whole contract of such a node (docs/nodes.md): two services and an action, joint states out, torques in.
Its simulation is much simpler than our plant: drives are rigid and carry B_theta, sensors have no noise, and the object
slides and does not turn. It reads no references or predictions, and publishes no ground truth.

    ./run python examples/foreign_plant.py                                         (in one terminal)
    ./run impact-rs campaign push -o campaigns/foreign --via nodes --without plant (in another)
"""

import signal
import time
from collections import Counter
from collections.abc import Mapping
from contextlib import suppress

import numpy as np
import pinocchio as pin
import rclpy
from geometry_msgs.msg import PoseStamped
from impact_rs.action import RunTrial
from impact_rs.srv import ConfigureTrial, FinishTrial
from rclpy.action import ActionServer, CancelResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future
from sensor_msgs.msg import JointState

from impact_msgs_py.conversions import pose_from_message, pose_to_message
from impact_rs_ros.exchange import Inbox
from impact_rs_ros.qos import AWAITED
from impact_rs_sim.physics import ArmPhysics
from impact_rs_sim.scene import Scene
from impact_rs_trials.bags import topics
from impact_rs_trials.bags.messages import joints_of
from impact_rs_trials.bags.trial_info import TrialInfo

DEPTH = 4000  # messages that a recorder which is late still gets
CONNECTING = 8.0  # s, for everybody to listen, and for the first torque
ANSWER, ASK_AGAIN = 1.5, 0.25  # s, for every later torque, and until the state is sent once more
SLICE = 0.02  # s, how long a trial keeps the node from its services
SUPPORT = 1e5  # N/m, stiffness of the support below the object


class Arm:
    """A rigid arm whose joints carry the reduced motor inertia.

    M(q) ddq + B_theta ddq + h(q, dq) = tau + J^T F
    """

    def __init__(self, physics: ArmPhysics, model: pin.Model, start: np.ndarray) -> None:
        self.physics = physics
        self.model = model.copy()
        self.model.armature = physics.motor_inertia("reduced")
        self.data = self.model.createData()
        self.frame = self.model.getFrameId("end_effector")
        self.q, self.dq, self.ddq = start, np.zeros_like(start), np.zeros_like(start)
        self.torque = pin.computeGeneralizedGravity(self.model, self.data, start)

    def pad(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Middle of the pad's face [m], its velocity [m/s], and the Jacobian of that, in the world frame."""
        frame, axes = self.frame, pin.LOCAL_WORLD_ALIGNED
        jacobian = pin.computeFrameJacobian(self.model, self.data, self.q, frame, axes)[:3]
        return pin.updateFramePlacement(self.model, self.data, frame).translation, jacobian @ self.dq, jacobian

    def step(self, torque: np.ndarray, force: np.ndarray, jacobian: np.ndarray, duration: float) -> None:
        """Go on for ``duration`` [s] with a desired torque [N m] and a force [N] on the pad; velocity first."""
        self.ddq = pin.aba(self.model, self.data, self.q, self.dq, torque + jacobian.T @ force)
        self.dq = self.dq + duration * self.ddq
        self.q = self.q + duration * self.dq
        self.torque = torque - self.model.armature * self.ddq  # what a sensor between motor and link feels


class World:
    """Arms, and a box that slides on a support; contacts are springs and dampers with Coulomb friction."""

    def __init__(self, scene: Scene, start: Mapping[str, np.ndarray], object_pose: np.ndarray) -> None:
        self.physics = scene.physics
        models = {name: model.pinocchio for name, model in scene.models.items()}
        self.arms = {name: Arm(self.physics.arms[name], models[name], start[name]) for name in start}
        self.centre, self.turn, self.velocity = object_pose[:3], object_pose[3:], np.zeros(3)
        self.axes = pin.Quaternion(self.turn).matrix()
        self.period = scene.scenario.timing.control_period
        self.substeps = scene.scenario.timing.substeps

    @property
    def object_pose(self) -> np.ndarray:
        """Position of its centre [m], and unit quaternion x y z w."""
        return np.concatenate((self.centre, self.turn))

    def step(self, torques: Mapping[str, np.ndarray]) -> None:
        """Go on for one control period."""
        duration = self.period / self.substeps
        for _ in range(self.substeps):
            mass = self.physics.object.mass
            load = mass * self.physics.gravity + self._support(duration)
            for name, arm in self.arms.items():
                position, velocity, jacobian = arm.pad()
                force = self._pad(arm.physics, position, velocity, duration)
                load = load - force
                arm.step(torques[name], force, jacobian, duration)
            self.velocity = self.velocity + duration / mass * load
            self.centre = self.centre + duration * self.velocity

    def _support(self, duration: float) -> np.ndarray:
        """Force of the support on the object [N]."""
        if self.physics.support_height is None:
            return np.zeros(3)
        up = np.array([0.0, 0.0, 1.0])
        depth = self.physics.support_height - (self.centre[2] - self.physics.object.size[2] / 2.0)
        damping = 2.0 * np.sqrt(SUPPORT * self.physics.object.mass)
        return self._contact(up, depth, self.velocity, SUPPORT, damping, self.physics.support_friction, duration)

    def _pad(self, arm: ArmPhysics, position: np.ndarray, velocity: np.ndarray, duration: float) -> np.ndarray:
        """Force of the object on a pad [N]."""
        away = self.axes.T @ (position - self.centre) / (self.physics.object.size / 2.0)  # 1 on a face
        side = int(np.argmax(np.abs(away)))
        normal = np.sign(away[side]) * self.axes[:, side]
        depth = self.physics.object.size[side] / 2.0 * (1.0 - abs(away[side]))
        stiffness = arm.pad_stiffness or SUPPORT
        relative = velocity - self.velocity
        return self._contact(normal, depth, relative, stiffness, arm.pad_damping, self.physics.pad_friction, duration)

    def _contact(self, normal, depth, velocity, stiffness, damping, friction, duration) -> np.ndarray:
        """Force [N] on what moves with ``velocity`` and is ``depth`` [m] inside; friction sticks as a stiff damper."""
        if depth <= 0.0:
            return np.zeros(3)
        press = max(0.0, stiffness * depth - damping * float(normal @ velocity))
        slip = velocity - (normal @ velocity) * normal
        sticking = self.physics.object.mass / (2.0 * duration) * slip
        size = float(np.linalg.norm(sticking))
        return press * normal - sticking * min(1.0, friction * press / size if size else 0.0)


class ForeignPlant:
    """Serves what the plant serves, and publishes what a robot would."""

    def __init__(self) -> None:
        self.node = Node("plant")
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.node)
        self.node.create_service(ConfigureTrial, "~/configure_trial", self.configure)
        self.node.create_service(FinishTrial, "~/finish_trial", self.finish)
        self.runs = ActionServer(
            self.node, RunTrial, "~/run_trial", self.run, cancel_callback=lambda goal: CancelResponse.ACCEPT
        )
        self.inbox = Inbox(self.node, AWAITED)  # takes torques past the executor: the sooner they are here
        self.publishers: dict[str, Publisher] = {}
        self.commands: dict[str, str] = {}
        self.goal: ServerGoalHandle | None = None  # present while a trial runs
        self.over = Future()  # of this goal: why it failed
        self.ready = self.begun = False
        self.attempt = 0  # at a trial, the last one that was configured
        self.finished = FinishTrial.Response(message="plant: there is no trial to finish")  # answer on the last end
        self.node.get_logger().info("ready")

    def configure(self, request: ConfigureTrial.Request, response: ConfigureTrial.Response) -> ConfigureTrial.Response:
        """Get ready for a trial, whatever became of the one before; once, though the request may be sent again."""
        response.success = 0 < request.attempt == self.attempt
        if response.success:
            return response
        self.end("another trial was configured")
        try:
            spec = TrialInfo.from_message(request.trial).spec
            self.joints = joints_of(spec.scene.physics)
            positions = dict(zip(request.start.name, request.start.position, strict=True))
            start = {arm: np.array([positions[joint] for joint in joints]) for arm, joints in self.joints.items()}
            self.world = World(spec.scene, start, pose_from_message(request.object_pose))
        except Exception as error:  # a wrong request must not end the node
            response.message = f"plant: {error}"
            return response
        timing, sensors = spec.scenario.timing, spec.scenario.sensors
        self.trial = f"{request.trial.scenario}/{request.trial.object}, {request.trial.case_name}"
        self.period_ns, self.last = round(timing.control_period * 1e9), timing.ticks
        self.object_every = max(1, round(sensors.object_period / timing.control_period))
        for arm in start:
            self.offer(f"{arm}/joint_states", JointState)
        self.offer("object/pose", PoseStamped)
        commands = {topics.joint_command(arm): topics.JOINT_STATE for arm in start}
        if commands != self.commands:
            self.commands = commands
            self.inbox.connect(commands)
        self.counts: Counter[str] = Counter()
        self.torques: dict[str, np.ndarray] = {}  # those of the present tick
        self.tick, self.begun, self.since = 0, False, time.monotonic()
        self.attempt, self.ready, response.success = request.attempt, True, True
        return response

    async def run(self, goal: ServerGoalHandle) -> RunTrial.Result:
        """Run the trial; the result comes when it is over."""
        result = RunTrial.Result(outcome="ABORTED", message="plant: configure a trial first")
        if self.ready and self.goal is None:
            self.goal, self.over = goal, Future(executor=self.executor)
            result.message = await self.over
        if not result.message:
            result = RunTrial.Result(success=True, outcome="OK")
        (goal.succeed if result.success else goal.canceled if goal.is_cancel_requested else goal.abort)()
        return result

    def finish(self, request: FinishTrial.Request, response: FinishTrial.Response) -> FinishTrial.Response:
        """Leave the trial, and say how many messages of each topic the recorder shall have."""
        if not self.ready or request.attempt not in (0, self.attempt):
            return self.finished
        self.end("the trial was aborted")
        self.ready, response.success = False, True
        response.outcome = "ABORTED" if request.aborted else "OK"
        response.topics, response.counts = list(self.counts), list(self.counts.values())
        response.messages = self.counts.total()
        after = f"{response.outcome} after {1e-9 * self.tick * self.period_ns:.3f} s"
        self.node.get_logger().info(f"{self.trial}: {after} {request.reason}")
        self.finished = response
        return response

    def offer(self, topic: str, kind: type) -> None:
        """Publish a topic, reliably: the recorder must not lose a sample."""
        if topic not in self.publishers:
            self.publishers[topic] = self.node.create_publisher(kind, topic, DEPTH)

    def end(self, failure: str = "") -> None:
        """The trial of the goal is over."""
        if self.goal is not None:
            self.goal = None
            self.over.set_result(failure)

    def spin(self) -> None:
        """Serve, and in between go on with the trial that runs."""
        while True:
            self.executor.spin_once(timeout_sec=0.1 if self.goal is None else 0.0)
            until = time.monotonic() + SLICE
            if self.goal is not None and self.goal.is_cancel_requested:
                self.end("plant was cancelled")
            while self.goal is not None and time.monotonic() < until:
                self.go_on()

    def go_on(self) -> None:
        """Begin when all subscribers are matched; then wait for the torques of the tick, and step to the next one."""
        waited = time.monotonic() - self.since
        if not self.begun:
            # Wait for the recorder on every topic and for the controller on the joints, or the first samples are lost.
            unmatched = [n for n, p in self.publishers.items() if p.get_subscription_count() < 1 + n.endswith("states")]
            if not unmatched:
                self.begun = True
                self.publish()
            elif waited > CONNECTING:
                self.end(f"no subscriber on {', '.join(unmatched)}: are controller and recorder running?")
            else:
                time.sleep(0.005)
            return
        self.inbox.wait(SLICE)
        for topic, message in self.inbox.take():
            self.hear(topic.split("/")[1], message)
        if len(self.torques) == len(self.joints):
            if self.tick == self.last:
                self.end()
                return
            self.world.step(self.torques)
            self.tick += 1
            self.torques = {}
            self.publish()
        elif waited > (ANSWER if self.tick else CONNECTING):
            self.end(f"no torque at t = {1e-9 * self.tick * self.period_ns:.3f} s: is the controller gone?")
        elif time.monotonic() > self.asked + ASK_AGAIN:
            self.ask()

    def hear(self, arm: str, message: JointState) -> None:
        """Take a torque that belongs to the present tick, with its joints in our order."""
        stamp = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
        if self.goal is not None and stamp == self.tick * self.period_ns:
            self.torques[arm] = np.array([message.effort[message.name.index(joint)] for joint in self.joints[arm]])

    def publish(self) -> None:
        """Publish the state of this tick."""
        self.since = time.monotonic()
        self.ask()
        for arm in self.joints:
            self.counts[self.node.resolve_topic_name(f"{arm}/joint_states")] += 1
        if self.tick % self.object_every == 0:
            pose = pose_to_message(self.world.object_pose)
            self.publishers["object/pose"].publish(self.stamped(PoseStamped(pose=pose)))
            self.counts[self.node.resolve_topic_name("object/pose")] += 1

    def ask(self) -> None:
        """Publish the joint states, which the controller answers; a repetition keeps its stamp and counts once."""
        self.asked = time.monotonic()
        for name, arm in self.world.arms.items():
            state = JointState(name=self.joints[name], position=arm.q, velocity=arm.dq, effort=arm.torque)
            self.publishers[f"{name}/joint_states"].publish(self.stamped(state))

    def stamped(self, message: JointState | PoseStamped) -> JointState | PoseStamped:
        """The message with the trial time of this tick."""
        message.header.frame_id = "world"
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(self.tick * self.period_ns, 10**9)
        return message


def main() -> None:
    """Run the node until Ctrl-C or SIGTERM."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    with suppress(KeyboardInterrupt):
        ForeignPlant().spin()
    rclpy.try_shutdown()


if __name__ == "__main__":
    main()
