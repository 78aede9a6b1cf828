"""Picture and animation of the flanks wearing, by ParaView without a display.

    xvfb-run -a pvbatch --force-offscreen-rendering demos/wear_in_paraview.py demos/results/fretting_wear/fields OUT

Reads what ``fretting_wear.py`` wrote, paints both bodies by the worn gap, moves the blade's flanks into the blade by 20
times the worn depth, and writes ``wear.png`` (the last cycle) and ``wear_0000.png`` ... (the animation) to ``OUT``.
"""

import sys
from pathlib import Path

from paraview.simple import (
    AppendAttributes,
    ColorBy,
    CreateRenderView,
    GetColorTransferFunction,
    GetScalarBar,
    Render,
    SaveScreenshot,
    Show,
    Text,
    WarpByVector,
    Xdmf3ReaderS,
)

EXAGGERATION = 20.0
LOWEST, HIGHEST = 0.166, 0.194  # of the root in the picture [m]

fields, out = map(Path, sys.argv[1:3])
out.mkdir(parents=True, exist_ok=True)
readers = [Xdmf3ReaderS(FileName=[str(fields / f"{name}.xdmf")]) for name in ("worn_surface", "worn_gap")]
readers[0].UpdatePipelineInformation()
cycles = list(readers[0].TimestepValues)

view = CreateRenderView(ViewSize=[1000, 800])
view.OrientationAxesVisibility = 0
view.UseColorPaletteForBackground = 0
view.Background = [1.0, 1.0, 1.0]

worn = WarpByVector(Input=AppendAttributes(Input=readers), Vectors=["POINTS", "worn_surface"])
worn.ScaleFactor = EXAGGERATION
shown = Show(worn, view)
shown.SetRepresentationType("Surface With Edges")
shown.EdgeColor = [0.75, 0.75, 0.75]
shown.Ambient, shown.Diffuse = 1.0, 0.0  # colours as in the bar, whatever the light
label = Text()
caption = Show(label, view)
caption.Color, caption.FontSize = [0.0, 0.0, 0.0], 18

# one scale for all frames: that of the last
worn.UpdatePipeline(cycles[-1])
deepest = worn.PointData.GetArray("worn_gap").GetRange()[1]
ColorBy(shown, ("POINTS", "worn_gap"))
colours = GetColorTransferFunction("worn_gap")
colours.ApplyPreset("Viridis (matplotlib)", True)
colours.InvertTransferFunction()
colours.RescaleTransferFunction(0.0, deepest)
bar = GetScalarBar(colours, view)
bar.Title, bar.ComponentTitle = "worn gap [m]", ""
bar.TitleColor = bar.LabelColor = [0.0, 0.0, 0.0]
shown.SetScalarBarVisibility(view, True)

Render(view)  # ParaView places the camera with the first picture; ours comes after
view.CameraParallelProjection = 1
view.CameraPosition = [0.0, 0.5 * (LOWEST + HIGHEST), 1.0]
view.CameraFocalPoint = [0.0, 0.5 * (LOWEST + HIGHEST), 0.0]
view.CameraParallelScale = 0.55 * (HIGHEST - LOWEST)

for number, cycle in enumerate(cycles):
    view.ViewTime = cycle
    label.Text = f"{cycle:.0f} cycles, wear enlarged {EXAGGERATION:.0f} times"
    Render(view)
    SaveScreenshot(str(out / f"wear_{number:04d}.png"), view)
SaveScreenshot(str(out / "wear.png"), view)
print(f"wrote {len(cycles)} frames and wear.png to {out}")
