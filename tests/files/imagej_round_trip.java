import ij.gui.Roi;
import ij.gui.OvalRoi;
import ij.io.RoiDecoder;
import ij.io.RoiEncoder;
import java.io.*;
import java.util.zip.*;

/** Reads a ROI zip with ImageJ's own decoder, prints each region, and writes them again, moved by 1.25 px. */
public class ImagejRoundTrip {
    public static void main(String[] files) throws Exception {
        try (ZipInputStream in = new ZipInputStream(new FileInputStream(files[0]));
             ZipOutputStream out = new ZipOutputStream(new FileOutputStream(files[1]))) {
            ZipEntry entry;
            while ((entry = in.getNextEntry()) != null) {
                Roi roi = new RoiDecoder(in.readAllBytes(), entry.getName()).getRoi();
                java.awt.geom.Rectangle2D box = roi.getFloatBounds();
                System.out.println(roi.getName() + "," + (roi instanceof OvalRoi) + "," + box.getX() + ","
                    + box.getY() + "," + box.getWidth() + "," + box.getHeight());
                roi.setLocation(box.getX() + 1.25, box.getY());
                out.putNextEntry(new ZipEntry(entry.getName()));
                out.write(RoiEncoder.saveAsByteArray(roi));
            }
        }
    }
}
