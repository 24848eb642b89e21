"""Which of AirSim's calls are done, accepted or refused here, as a page.

    python -m uavaccel.wire.call_table > docs/airsim-calls.md

The names are those of AirSim v1.8.1's Python client on the wire (PythonClient/airsim/client.py).
"""

from __future__ import annotations

from uavaccel.sim.profile import NATIVE
from uavaccel.sim.simulation import Simulation
from uavaccel.sim.world import World
from uavaccel.wire.api import Api
from uavaccel.wire.world_api import ACCEPTED, REFUSED

CALLS = {
    "Connection and time": """
        ping getServerVersion getMinRequiredClientVersion reset simPause simIsPaused simContinueForTime
        simContinueForFrames getSettingsString""",
    "Vehicles": """
        enableApiControl isApiControlEnabled armDisarm listVehicles simAddVehicle simGetVehiclePose simSetVehiclePose
        simGetGroundTruthKinematics simSetKinematics getMultirotorState getRotorStates simGetCollisionInfo
        cancelLastTask""",
    "Flight": """
        takeoff land goHome hover moveByVelocity moveByVelocityZ moveByVelocityBodyFrame moveByVelocityZBodyFrame
        moveOnPath moveToPosition moveToGPS moveToZ moveByManual moveByRC rotateToYaw rotateByYawRate moveByMotorPWMs
        moveByRollPitchYawZ moveByRollPitchYawThrottle moveByRollPitchYawrateThrottle moveByRollPitchYawrateZ
        moveByAngleRatesZ moveByAngleRatesThrottle setAngleRateControllerGains setAngleLevelControllerGains
        setVelocityControllerGains setPositionControllerGains""",
    "Cameras and images": """
        simGetImage simGetImages simGetCameraInfo simSetCameraPose simSetCameraFov simGetDistortionParams
        simSetDistortionParam simGetPresetLensSettings simGetLensSettings simSetPresetLensSettings
        simGetPresetFilmbackSettings simSetPresetFilmbackSettings simGetFilmbackSettings simSetFilmbackSettings
        simGetFocalLength simSetFocalLength simEnableManualFocus simGetFocusDistance simSetFocusDistance
        simGetFocusAperture simSetFocusAperture simEnableFocusPlane simGetCurrentFieldOfView""",
    "Objects": """
        simListSceneObjects simGetObjectPose simSetObjectPose simGetObjectScale simSetObjectScale simSpawnObject
        simDestroyObject simListAssets simLoadLevel simSetSegmentationObjectID simGetSegmentationObjectID
        simAddDetectionFilterMeshName simSetDetectionFilterRadius simClearDetectionMeshNames simGetDetections
        simSwapTextures simSetObjectMaterial simSetObjectMaterialFromTexture simGetMeshPositionVertexBuffers
        simCreateVoxelGrid""",
    "Sensors": """
        getImuData getBarometerData getMagnetometerData getGpsData getDistanceSensorData getLidarData""",
    "World": """
        simGetGroundTruthEnvironment getHomeGeoPoint simSetWind simTestLineOfSightToPoint
        simTestLineOfSightBetweenPoints simGetWorldExtents simSetTimeOfDay simEnableWeather simSetWeatherParameter
        simSetLightIntensity simRunConsoleCommand""",
    "Recording, drawing, messages": """
        startRecording stopRecording isRecording simPrintLogMessage simSetTraceLine simFlushPersistentMarkers
        simPlotPoints simPlotLineStrip simPlotLineList simPlotArrows simPlotStrings simPlotTransforms
        simPlotTransformsWithNames""",
}
HEAD = """# AirSim's calls

Every call of AirSim v1.8.1's Python client, by its name on the wire. *Done*: it does here what it does there.
*Accepted*: it is answered and has no effect; the server names it once on its terminal. *Refused*: the caller gets an
error that names it. Made by `python -m uavaccel.wire.call_table`.
"""


def status(name: str, known: set[str]) -> str:
    """One of "done", "accepted" and "refused", with the reason."""
    if name in ACCEPTED:
        return "accepted"
    if name in REFUSED:
        return f"refused: {REFUSED[name]}"
    return "done" if name in known else "refused: unknown here"


def page() -> str:
    """The page, in Markdown."""
    known = set(Api(Simulation(World("blocks", NATIVE))).methods)
    answers = {name: status(name, known) for names in CALLS.values() for name in names.split()}
    counts = [
        sum(answer.startswith(word) for answer in answers.values())
        for word in ("done", "accepted", "refused")
    ]
    lines = [
        HEAD,
        f"Of {len(answers)} calls {counts[0]} are done, {counts[1]} accepted, {counts[2]} refused.",
    ]
    for title, names in CALLS.items():
        rows = [f"| `{name}` | {answers[name]} |" for name in names.split()]
        lines += ["", f"## {title}", "", "| call | here |", "|---|---|", *rows]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    print(page(), end="")
